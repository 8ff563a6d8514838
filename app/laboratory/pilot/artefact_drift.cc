#include "app/laboratory/pilot/artefact_drift.h"

#include <fmt/format.h>

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

}  // namespace

Eigen::MatrixXd measurements_covariance(const std::vector<ArtefactMeasurement>& measurements,
                                        const std::vector<SharedSource>& shared) {
  const Index p = measurements.front().values.size();
  const std::size_t count = measurements.size();
  MatrixXd all = MatrixXd::Zero(static_cast<Index>(count) * p, static_cast<Index>(count) * p);
  const auto block = [&](std::size_t i, std::size_t j) {
    return all.block(static_cast<Index>(i) * p, static_cast<Index>(j) * p, p, p);
  };
  for (std::size_t i = 0; i < count; ++i) block(i, i) = measurements[i].covariance;
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t j = i + 1; j < count; ++j) {
      if (measurements[i].participant != measurements[j].participant) continue;
      // The common part has the correlations of the participant's first measurement.
      const ArtefactMeasurement& first =
          *std::ranges::find(measurements, measurements[i].participant, &ArtefactMeasurement::participant);
      const VectorXd inverse = first.covariance.diagonal().cwiseSqrt().cwiseInverse();
      const MatrixXd correlation = inverse.asDiagonal() * first.covariance * inverse.asDiagonal();
      std::array<VectorXd, 2> common;
      for (std::size_t side = 0; side < 2; ++side) {
        const ArtefactMeasurement& one = measurements[side == 0 ? i : j];
        const VectorXd variance = one.covariance.diagonal() - one.repeatability.cwiseAbs2();
        if (!(one.repeatability.array() > 0.0).all() || !(variance.array() >= 0.0).all())
          throw KeyComparisonError(
              "the repeatability of a participant with several measurements must be above 0 and at most its "
              "stated uncertainty");
        common[side] = variance.cwiseSqrt();
      }
      block(i, j) = common[0].asDiagonal() * correlation * common[1].asDiagonal();
      block(j, i) = block(i, j).transpose();
    }
  }
  // A repeat is its common part and its repeatability, so that all together stay positive definite.
  for (std::size_t i = 0; i < count; ++i) {
    const ArtefactMeasurement& one = measurements[i];
    if (std::ranges::count(measurements, one.participant, &ArtefactMeasurement::participant) < 2) continue;
    const ArtefactMeasurement& first =
        *std::ranges::find(measurements, one.participant, &ArtefactMeasurement::participant);
    const VectorXd inverse = first.covariance.diagonal().cwiseSqrt().cwiseInverse();
    const MatrixXd correlation = inverse.asDiagonal() * first.covariance * inverse.asDiagonal();
    const VectorXd common = (one.covariance.diagonal() - one.repeatability.cwiseAbs2()).cwiseSqrt();
    const VectorXd part = one.repeatability.cwiseQuotient(one.covariance.diagonal().cwiseSqrt());
    block(i, i) = common.asDiagonal() * correlation * common.asDiagonal();
    block(i, i) += part.asDiagonal() * one.covariance * part.asDiagonal();
  }
  for (const SharedSource& source : shared) {
    if (source.u.size() != p)
      throw KeyComparisonError(
          fmt::format("shared source {}: {} uncertainties; required: {}", source.name, source.u.size(), p));
    const MatrixXd common = source.together ? MatrixXd(source.u * source.u.transpose())
                                            : MatrixXd(source.u.cwiseAbs2().asDiagonal());
    const auto has = [&](std::size_t participant) {
      return std::ranges::find(source.participants, participant) != source.participants.end();
    };
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t j = 0; j < count; ++j)
        if (measurements[i].participant != measurements[j].participant && has(measurements[i].participant) &&
            has(measurements[j].participant))
          block(i, j) += common;
  }
  return all;
}

TransferredResults transferred_results(const std::vector<ArtefactMeasurement>& measurements,
                                       const std::vector<SharedSource>& shared,
                                       const std::vector<double>& coverage_factors, std::size_t pilot,
                                       DriftModel model, double level) {
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
  const bool slope = model == DriftModel::kLine;
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
  if (count > 1 && (!slope || out.line) && tested.probability < level)
    out.step = step_of(repeats, slope, tested);

  const auto n = static_cast<Index>(coverage_factors.size());
  MatrixXd map = MatrixXd::Zero(n * p, covariance.rows());
  const MatrixXd of_rate = slope ? MatrixXd(fit.map.bottomRows(p)) : MatrixXd::Zero(p, fit.map.cols());
  map(Eigen::seqN(static_cast<Index>(pilot) * p, p), rows) = fit.map.topRows(p);
  for (std::size_t k = 0; k < measurements.size(); ++k) {
    if (measurements[k].participant == pilot) continue;
    const Index to = static_cast<Index>(measurements[k].participant) * p;
    map.block(to, static_cast<Index>(k) * p, p, p).setIdentity();
    map(Eigen::seqN(to, p), rows) -= (measurements[k].time - out.reference_time) * of_rate;
  }
  out.results = {.quantities = p,
                 .values = map * from_origin + origin.replicate(n, 1),
                 .covariance = map * covariance * map.transpose(),
                 .coverage_factors = coverage_factors};
  out.rate = of_rate * repeats.values;
  out.rate_covariance = of_rate * repeats.covariance * of_rate.transpose();
  return out;
}

}  // namespace abcal
