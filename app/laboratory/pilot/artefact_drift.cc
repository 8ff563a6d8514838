#include "app/laboratory/pilot/artefact_drift.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "app/laboratory/compare/generalised_fit.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

ConsistencyTest test_of_fit(const GeneralisedFit& fit) {
  return {fit.chi2, fit.degrees_of_freedom,
          fit.degrees_of_freedom > 0 ? chi2_tail(fit.chi2, fit.degrees_of_freedom) : 1.0};
}

/// The pilot's repeats, in the order of time.
struct Repeats {
  std::vector<std::size_t> positions;
  std::vector<double> times;  ///< From the reference time.
  VectorXd values;            ///< From those of the first.
  MatrixXd covariance;
  Index quantities = 0;

  /// Columns of one value for each quantity, a slope if the model has one, and a step after repeat `after`.
  MatrixXd design(bool slope, std::optional<std::size_t> after = std::nullopt) const {
    const Index p = quantities, blocks = 1 + (slope ? 1 : 0) + (after ? 1 : 0);
    MatrixXd columns = MatrixXd::Zero(values.size(), blocks * p);
    for (std::size_t k = 0; k < times.size(); ++k) {
      const Index row = static_cast<Index>(k) * p;
      columns.block(row, 0, p, p).setIdentity();
      if (slope) columns.block(row, p, p, p) = times[k] * MatrixXd::Identity(p, p);
      if (after && k > *after) columns.block(row, (blocks - 1) * p, p, p).setIdentity();
    }
    return columns;
  }
};

/// The interval in which the artefact changed most.
ArtefactStep step_of(const Repeats& repeats, bool slope, const ConsistencyTest& test) {
  const Index p = repeats.quantities;
  const std::size_t count = repeats.positions.size();
  // With too few repeats for a slope and a step, the step alone.
  const bool with_slope = slope && count > 3;
  double least = std::numeric_limits<double>::infinity();
  ArtefactStep step{.test = test};
  for (std::size_t after = 0; after + 1 < count; ++after) {
    const MatrixXd design = repeats.design(with_slope, after);
    const GeneralisedFit fit = generalised_fit(design, repeats.values, repeats.covariance);
    if (!(fit.chi2 < least)) continue;
    least = fit.chi2;
    step.before = repeats.positions[after];
    step.after = repeats.positions[after + 1];
    const MatrixXd of_step = fit.map.bottomRows(p);
    const VectorXd change = of_step * repeats.values;
    const VectorXd u = (of_step * repeats.covariance * of_step.transpose()).diagonal().cwiseSqrt();
    change.cwiseQuotient(u).cwiseAbs().maxCoeff(&step.quantity);
    step.change = change(step.quantity);
    step.u = u(step.quantity);
  }
  return step;
}

void require_prior(const DriftPrior& prior) {
  if (!(prior.walk >= 0.0 && prior.walk <= 1.0) || prior.sizes.empty() ||
      !std::ranges::all_of(prior.sizes, [](double size) { return size > 0.0 && std::isfinite(size); }))
    throw KeyComparisonError(
        "a prior of the drift needs a probability of a walk from 0 to 1 and sizes above 0");
}

/// How results and rates follow from all measurements.
struct Transfer {
  MatrixXd map;   ///< n p x all: transferred results, participant by participant.
  MatrixXd rate;  ///< p x all
  /// Covariance of results and rates, in this order, that the model of the drift adds to that of the
  /// measurements.
  MatrixXd model_covariance;
};

/// The measurements of one quantity, in the order of the schedule.
struct OneQuantity {
  VectorXd times, values;  ///< From the reference time, from the origin.
  MatrixXd covariance;
  std::vector<Index> repeats;  ///< Places of the pilot's.
  std::vector<Index> rows;     ///< Row of the result that each measurement gives.
  Index participants = 0;

  double span() const { return times(repeats.back()) - times(repeats.front()); }
};

/// Covariance of a drift at all times, 0 at the reference time, whose change in the span has the size `size`.
MatrixXd drift_covariance(const OneQuantity& measured, bool walk, double size) {
  const VectorXd fraction = measured.times / measured.span();
  MatrixXd covariance = fraction * fraction.transpose();
  if (walk)
    covariance =
        covariance.binaryExpr(fraction.replicate(1, fraction.size()), [](double product, double one) {
          return product > 0.0 ? std::min(std::abs(one), product / std::abs(one)) : 0.0;
        });
  return size * size * covariance;
}

/// Results and rate by one model of the drift.
struct WeighedModel {
  bool walk;
  double log_weight;    ///< Prior and marginal likelihood.
  MatrixXd map;         ///< n + 1 x all: results of the participants, and the rate.
  MatrixXd covariance;  ///< Covariance of their errors.
};

/// The repeats y have a mean x with a flat prior and the covariance V, which is that of the measurements and
/// K of the drift. The result at the reference time is the generalised mean of y; the drift of each
/// measurement is K V^-1 (y - x).
WeighedModel model_of(const OneQuantity& measured, bool walk, double probability, double size) {
  const std::vector<Index>& repeats = measured.repeats;
  const auto count = static_cast<Index>(repeats.size()), n = measured.participants;
  const MatrixXd drift = drift_covariance(measured, walk, size);
  const Eigen::LLT<MatrixXd> factor(measured.covariance(repeats, repeats) + drift(repeats, repeats));
  if (factor.info() != Eigen::Success)
    throw KeyComparisonError("the covariances of the pilot's measurements contradict one another");
  const VectorXd ones = VectorXd::Ones(count), weights = factor.solve(ones);
  const double information = weights.sum();
  const MatrixXd mean = weights.transpose() / information;
  const MatrixXd residual = MatrixXd::Identity(count, count) - ones * mean;
  const MatrixXd of_drift = drift(Eigen::all, repeats) * factor.solve(residual);
  MatrixXd map = MatrixXd::Zero(n + 1, measured.times.size());
  for (Index k = 0; k < measured.times.size(); ++k) {
    if (std::ranges::find(repeats, k) != repeats.end()) continue;
    map(measured.rows[static_cast<std::size_t>(k)], k) = 1.0;
    map(measured.rows[static_cast<std::size_t>(k)], repeats) -= of_drift.row(k);
  }
  const Index first = repeats.front(), last = repeats.back();
  map(measured.rows[static_cast<std::size_t>(first)], repeats) = mean;
  map(n, repeats) = (of_drift.row(last) - of_drift.row(first)) / measured.span();
  // The rate has the error of the drift's change, the results have that of the drift at their times.
  MatrixXd of_drift_error = map;
  of_drift_error(n, last) -= 1.0 / measured.span();
  of_drift_error(n, first) += 1.0 / measured.span();
  const VectorXd errors = residual * measured.values(repeats);
  const double log_determinant =
      2.0 * factor.matrixLLT().diagonal().array().log().sum() + std::log(information);
  return {.walk = walk,
          .log_weight = std::log(probability) - 0.5 * (log_determinant + errors.dot(factor.solve(errors))),
          .map = map,
          .covariance = map * measured.covariance * map.transpose() +
                        of_drift_error * drift * of_drift_error.transpose()};
}

/// The mean of lines and walks of all sizes.
struct AveragedModel {
  double walk_probability = 0.0;
  MatrixXd map;               ///< As WeighedModel::map.
  MatrixXd model_covariance;  ///< Part of the covariance from the drift and the choice of its model.
};
AveragedModel average_of_models(const OneQuantity& measured, const DriftPrior& prior, double unit) {
  std::vector<WeighedModel> models;
  for (const bool walk : {false, true})
    for (const double size : prior.sizes)
      models.push_back(model_of(measured, walk, walk ? prior.walk : 1.0 - prior.walk, size * unit));
  const double largest = std::ranges::max(models, {}, &WeighedModel::log_weight).log_weight;
  AveragedModel mean;
  mean.map = MatrixXd::Zero(models.front().map.rows(), models.front().map.cols());
  double sum = 0.0;
  for (const WeighedModel& one : models) sum += std::exp(one.log_weight - largest);
  const auto weight = [&](const WeighedModel& one) { return std::exp(one.log_weight - largest) / sum; };
  for (const WeighedModel& one : models) {
    mean.map += weight(one) * one.map;
    if (one.walk) mean.walk_probability += weight(one);
  }
  mean.model_covariance = -mean.map * measured.covariance * mean.map.transpose();
  for (const WeighedModel& one : models) {
    const VectorXd apart = (one.map - mean.map) * measured.values;
    mean.model_covariance += weight(one) * (one.covariance + apart * apart.transpose());
  }
  return mean;
}

void require_measurements(const std::vector<ArtefactMeasurement>& measurements,
                          const std::vector<double>& coverage_factors, std::size_t pilot) {
  const std::size_t n = coverage_factors.size();
  std::vector<int> count(n, 0);
  const Index p = measurements.empty() ? 0 : measurements.front().values.size();
  for (const ArtefactMeasurement& one : measurements) {
    if (one.participant >= n || one.values.size() != p || one.covariance.rows() != p ||
        one.covariance.cols() != p)
      throw KeyComparisonError("measurements of different quantities, or of a participant without a number");
    ++count[one.participant];
  }
  for (std::size_t i = 0; i < n; ++i) {
    if (count[i] == 0 || (count[i] > 1 && i != pilot))
      throw KeyComparisonError(fmt::format(
          "participant {} has {} measurements; required: one of each, and several of the pilot alone", i + 1,
          count[i]));
  }
}

/// The part of a measurement that a participant's repeats have in common; all of it without repeats.
struct CommonPart {
  VectorXd u;
  MatrixXd correlation;  ///< That of the participant's first measurement.
  VectorXd own;          ///< The rest, which differs between repeats, as a part of the stated uncertainty.
};
CommonPart common_part(const std::vector<ArtefactMeasurement>& measurements, const ArtefactMeasurement& one) {
  const MatrixXd& first =
      std::ranges::find(measurements, one.participant, &ArtefactMeasurement::participant)->covariance;
  const VectorXd inverse = first.diagonal().cwiseSqrt().cwiseInverse();
  const VectorXd u = one.covariance.diagonal().cwiseSqrt();
  CommonPart common{u, inverse.asDiagonal() * first * inverse.asDiagonal(), VectorXd::Zero(u.size())};
  if (std::ranges::count(measurements, one.participant, &ArtefactMeasurement::participant) < 2) return common;
  const VectorXd variance = one.covariance.diagonal() - one.repeatability.cwiseAbs2();
  if (!(one.repeatability.array() > 0.0).all() || !(variance.array() >= 0.0).all())
    throw KeyComparisonError(
        "the repeatability of a participant with several measurements must be above 0 and at most its "
        "stated uncertainty");
  common.u = variance.cwiseSqrt();
  common.own = one.repeatability.cwiseQuotient(u);
  return common;
}

/// A matrix whose product with that of another participant is their covariance in some quantities, if an
/// effect moves all of these.
MatrixXd root_in(const CommonPart& common, const std::vector<Index>& quantities) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(common.correlation(quantities, quantities));
  MatrixXd root = MatrixXd::Zero(common.u.size(), common.u.size());
  root(quantities, quantities) = common.u(quantities).asDiagonal() * solver.operatorSqrt();
  return root;
}

void require_positive_definite(const MatrixXd& covariance, const SharedSource& source) {
  const VectorXd inverse = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(
      inverse.asDiagonal() * covariance * inverse.asDiagonal(), Eigen::EigenvaluesOnly);
  // Eigenvalues of a correlation matrix are uncertain by its size in units of the rounding.
  const double rounding = static_cast<double>(covariance.rows()) * std::numeric_limits<double>::epsilon();
  if (solver.eigenvalues()(0) > rounding) return;
  throw KeyComparisonError(fmt::format(
      "correlation {:g} by {}: with it the covariance of the results is not positive definite (smallest "
      "eigenvalue of the correlation matrix {:.2g}); required: a smaller correlation, which together with "
      "the "
      "other common parts is possible",
      *source.correlation, source.name, solver.eigenvalues()(0)));
}

}  // namespace

Eigen::MatrixXd measurements_covariance(const std::vector<ArtefactMeasurement>& measurements,
                                        const std::vector<SharedSource>& shared) {
  const Index p = measurements.front().values.size();
  const std::size_t count = measurements.size();
  MatrixXd all = MatrixXd::Zero(static_cast<Index>(count) * p, static_cast<Index>(count) * p);
  const auto block = [&](std::size_t i, std::size_t j) {
    return all.block(static_cast<Index>(i) * p, static_cast<Index>(j) * p, p, p);
  };
  std::vector<CommonPart> common;
  for (const ArtefactMeasurement& one : measurements) common.push_back(common_part(measurements, one));
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t j = 0; j < count; ++j)
      if (measurements[i].participant == measurements[j].participant)
        block(i, j) = common[i].u.asDiagonal() * common[i].correlation * common[j].u.asDiagonal();
    // A repeat is its common part and its repeatability, so that all together stay positive definite.
    block(i, i) += common[i].own.asDiagonal() * measurements[i].covariance * common[i].own.asDiagonal();
  }
  const auto add = [&](const SharedSource& source, const auto& part_of) {
    const auto has = [&](std::size_t i) {
      return std::ranges::find(source.participants, measurements[i].participant) != source.participants.end();
    };
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t j = 0; j < count; ++j)
        if (measurements[i].participant != measurements[j].participant && has(i) && has(j))
          block(i, j) += part_of(i, j);
  };
  for (const SharedSource& source : shared) {
    if (source.correlation) continue;
    if (source.u.size() != p)
      throw KeyComparisonError(
          fmt::format("shared source {}: {} uncertainties; required: {}", source.name, source.u.size(), p));
    const MatrixXd part = source.together ? MatrixXd(source.u * source.u.transpose())
                                          : MatrixXd(source.u.cwiseAbs2().asDiagonal());
    add(source, [&](std::size_t, std::size_t) -> const MatrixXd& { return part; });
  }
  for (const SharedSource& source : shared) {
    if (!source.correlation) continue;
    std::vector<MatrixXd> roots;
    for (const CommonPart& one : common) roots.push_back(root_in(one, source.quantities));
    add(source, [&](std::size_t i, std::size_t j) {
      return MatrixXd(*source.correlation * roots[i] * roots[j].transpose());
    });
    require_positive_definite(all, source);
  }
  return all;
}

TransferredResults transferred_results(const std::vector<ArtefactMeasurement>& measurements,
                                       const std::vector<SharedSource>& shared,
                                       const std::vector<double>& coverage_factors, std::size_t pilot,
                                       DriftModel model, double level, const DriftPrior& prior) {
  require_measurements(measurements, coverage_factors, pilot);
  const Index p = measurements.front().values.size();
  const MatrixXd covariance = measurements_covariance(measurements, shared);
  Repeats repeats;
  repeats.quantities = p;
  std::vector<Index> rows;
  TransferredResults out;
  for (std::size_t k = 0; k < measurements.size(); ++k) {
    if (measurements[k].participant != pilot) continue;
    repeats.positions.push_back(k);
    repeats.times.push_back(measurements[k].time);
    for (Index q = 0; q < p; ++q) rows.push_back(static_cast<Index>(k) * p + q);
  }
  const std::size_t count = repeats.positions.size();
  const bool slope = model != DriftModel::kNone;
  const bool averaged = model == DriftModel::kLineOrWalk && count > 2;
  if (slope && (count < 2 || repeats.times.front() == repeats.times.back()))
    throw KeyComparisonError("a drift needs two measurements of the pilot, at different times");
  for (const double time : repeats.times) out.reference_time += time / static_cast<double>(count);
  for (double& time : repeats.times) time -= out.reference_time;
  // From the first measurement of the pilot: values may be large against their uncertainties.
  const VectorXd origin = measurements[repeats.positions.front()].values;
  VectorXd from_origin(static_cast<Index>(measurements.size()) * p);
  for (std::size_t k = 0; k < measurements.size(); ++k)
    from_origin.segment(static_cast<Index>(k) * p, p) = measurements[k].values - origin;
  repeats.values = from_origin(rows);
  repeats.covariance = covariance(rows, rows);

  const GeneralisedFit constant = generalised_fit(repeats.design(false), repeats.values, repeats.covariance);
  out.constant = test_of_fit(constant);
  const GeneralisedFit fit =
      slope ? generalised_fit(repeats.design(true), repeats.values, repeats.covariance) : constant;
  if (slope && count > 2) out.line = test_of_fit(fit);
  const ConsistencyTest tested = out.line.value_or(out.constant);
  if (!averaged && count > 1 && (!slope || out.line) && tested.probability < level)
    out.step = step_of(repeats, slope, tested);

  const auto n = static_cast<Index>(coverage_factors.size());
  Transfer transfer{.map = MatrixXd::Zero(n * p, covariance.rows()),
                    .rate = MatrixXd::Zero(p, covariance.rows()),
                    .model_covariance = MatrixXd::Zero((n + 1) * p, (n + 1) * p)};
  if (averaged) {
    require_prior(prior);
    out.walk_probability.resize(p);
    OneQuantity measured;
    measured.participants = n;
    measured.times.resize(static_cast<Index>(measurements.size()));
    for (std::size_t k = 0; k < measurements.size(); ++k) {
      const ArtefactMeasurement& one = measurements[k];
      measured.times(static_cast<Index>(k)) = one.time - out.reference_time;
      measured.rows.push_back(static_cast<Index>(one.participant));
      if (one.participant == pilot) measured.repeats.push_back(static_cast<Index>(k));
    }
    for (Index q = 0; q < p; ++q) {
      const auto of_all = Eigen::seqN(q, measured.times.size(), p);
      measured.values = from_origin(of_all);
      measured.covariance = covariance(of_all, of_all);
      const AveragedModel mean =
          average_of_models(measured, prior, measurements[repeats.positions.front()].repeatability(q));
      out.walk_probability(q) = mean.walk_probability;
      transfer.map(Eigen::seqN(q, n, p), of_all) = mean.map.topRows(n);
      transfer.rate(q, of_all) = mean.map.bottomRows(1);
      const auto of_results = Eigen::seqN(q, n + 1, p);
      transfer.model_covariance(of_results, of_results) = mean.model_covariance;
    }
  } else {
    if (slope) transfer.rate(Eigen::all, rows) = fit.map.bottomRows(p);
    transfer.map(Eigen::seqN(static_cast<Index>(pilot) * p, p), rows) = fit.map.topRows(p);
    for (std::size_t k = 0; k < measurements.size(); ++k) {
      if (measurements[k].participant == pilot) continue;
      const Index to = static_cast<Index>(measurements[k].participant) * p;
      transfer.map.block(to, static_cast<Index>(k) * p, p, p).setIdentity();
      transfer.map.middleRows(to, p) -= (measurements[k].time - out.reference_time) * transfer.rate;
    }
  }
  out.results = {.quantities = p,
                 .values = transfer.map * from_origin + origin.replicate(n, 1),
                 .covariance = transfer.map * covariance * transfer.map.transpose() +
                               transfer.model_covariance.topLeftCorner(n * p, n * p),
                 .coverage_factors = coverage_factors};
  out.rate = transfer.rate * from_origin;
  out.rate_covariance = transfer.rate * covariance * transfer.rate.transpose() +
                        transfer.model_covariance.bottomRightCorner(p, p);
  return out;
}

}  // namespace abcal
