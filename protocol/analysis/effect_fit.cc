#include "protocol/analysis/effect_fit.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>

#include "protocol/analysis/effect_model.h"
#include "protocol/analysis/reading_kernels.h"
#include "protocol/analysis/unusable_data.h"

namespace abcal {
namespace {

/// The grid of the noise process: tau in units of u, rho in angles.
constexpr std::array<double, 5> kTauGrid{0.3, 0.8, 2.0, 5.0, 12.0};
constexpr std::array<double, 4> kRhoGrid{2.0, 10.0, 50.0, 400.0};
/// A process whose whole neighbourhood is less probable than this is not worth a fit.
constexpr double kNegligibleWeight = 1e-6;
/// White noise is looked for until no output's moves by more (relative); at most so often.
constexpr double kWhiteFound = 1e-3;
constexpr int kWhitePasses = 60;
constexpr std::array<const char*, 3> kStepGroups{"f_1", "f_2", "f_3"};

/// The linear problem at one noise.
struct AtNoise {
  double log_likelihood = 0.0;  ///< Restricted.
  double tau = 0.0, rho = 1.0;
  Eigen::Vector3d white = Eigen::Vector3d::Ones();
  double chi2 = 0.0;
  Eigen::VectorXd change;  ///< Of the model's value.
  std::optional<NoiseWhitener> whitener;
  ReadingRows whitened_jacobian;
  Eigen::VectorXd whitened_residual;
  Eigen::VectorXd scale;
  Eigen::LLT<Eigen::MatrixXd> llt;

  /// R with C = R R', C the posterior covariance of the unknowns; upper triangular.
  Eigen::MatrixXd covariance_root() const {
    const auto count = scale.size();
    const Eigen::MatrixXd inverse = llt.matrixU().solve(Eigen::MatrixXd::Identity(count, count));
    return scale.asDiagonal() * inverse;
  }
};

/// What one noise says of the line response; relative units.
struct LineAtNoise {
  Vector12 change = Vector12::Zero();  ///< With the mean of the process.
  Covariance12 covariance = Covariance12::Zero();
  std::vector<Covariance12> shares;  ///< Of the priors, group by group.
  ReadingRows gain;                  ///< 3 N x 12
};

/// The unknowns that make one line of a budget.
struct ShareGroups {
  std::vector<EffectShare> groups;
  std::vector<int> of_unknown;  ///< -1: no prior.
  int first_step = -1;          ///< f_1, f_2, f_3; -1: no step errors are eliminated.
};

ShareGroups share_groups(const EffectModel& model) {
  ShareGroups out;
  for (const EffectUnknown& unknown : model.unknowns()) {
    if (!std::isfinite(unknown.prior_sd)) {
      out.of_unknown.push_back(-1);
      continue;
    }
    const auto found = std::find_if(out.groups.begin(), out.groups.end(),
                                    [&](const EffectShare& share) { return share.effect == unknown.effect; });
    if (found == out.groups.end()) {
      out.of_unknown.push_back(static_cast<int>(out.groups.size()));
      out.groups.push_back({unknown.effect, unknown.key, 1, unknown.prior_sd, Covariance12::Zero()});
    } else {
      out.of_unknown.push_back(static_cast<int>(found - out.groups.begin()));
      ++found->unknowns;
    }
  }
  if (!(model.step_sd() > 0.0)) return out;
  out.first_step = static_cast<int>(out.groups.size());
  for (const char* name : kStepGroups)
    out.groups.push_back({name, "step_deg", 0, model.step_sd(), Covariance12::Zero()});
  for (std::size_t n = 0; n < model.angles(); ++n)
    ++out.groups[static_cast<std::size_t>(out.first_step + model.experiment_of(n) - 1)].unknowns;
  return out;
}

AtNoise solve_at(const EffectModel& model, double tau, double rho, const Eigen::Vector3d& white) {
  AtNoise out;
  out.tau = tau;
  out.rho = rho;
  out.white = white;
  const NoiseWhitener& whitener =
      out.whitener.emplace(model.noise_at_angles(white), model.step_sd(), model.process_of(tau, rho));
  out.whitened_jacobian = model.jacobian();
  whitener.whiten(out.whitened_jacobian);
  ReadingRows residual = model.residual();
  whitener.whiten(residual);
  const Eigen::VectorXd& prior_weight = model.prior_weight();
  Eigen::MatrixXd normal = products_of_columns(out.whitened_jacobian);
  normal.diagonal() += prior_weight;
  out.scale = normal.diagonal().cwiseSqrt().cwiseInverse();
  normal = out.scale.asDiagonal() * normal * out.scale.asDiagonal();
  out.llt.compute(normal);
  const Eigen::VectorXd from_prior = model.from_prior();
  Eigen::VectorXd right = out.whitened_jacobian.transpose() * residual;
  right -= prior_weight.cwiseProduct(from_prior);
  out.change = out.scale.cwiseProduct(out.llt.solve(out.scale.cwiseProduct(right)));
  out.whitened_residual = residual - out.whitened_jacobian * out.change;
  out.chi2 = out.whitened_residual.squaredNorm() + prior_weight.dot((from_prior + out.change).cwiseAbs2());
  const double log_normal =
      2.0 * (out.llt.matrixLLT().diagonal().array().log().sum() - out.scale.array().log().sum());
  out.log_likelihood = -0.5 * (whitener.log_determinant() + log_normal + out.chi2);
  return out;
}

LineAtNoise line_at(const EffectModel& model, const AtNoise& at, const ShareGroups& groups) {
  LineAtNoise out;
  Rows12 rows = model.line_rows();
  Covariance12 beyond = Covariance12::Zero();
  out.change = rows * at.change;
  ReadingRows mean_weights;  // V^-1 cov(readings, means of the process)
  if (at.tau > 0.0) {
    // The mean of the process over the run belongs to the offset.
    mean_weights = at.whitener->covariance_with_mean();
    at.whitener->whiten(mean_weights);
    out.change.tail<3>() += mean_weights.transpose() * at.whitened_residual;
    rows.bottomRows<3>() -= mean_weights.transpose() * at.whitened_jacobian;
    beyond.bottomRightCorner<3, 3>() = -(mean_weights.transpose() * mean_weights);
    beyond.bottomRightCorner<3, 3>().diagonal() += at.whitener->mean_variance();
    at.whitener->whiten_transposed(mean_weights);
  }
  // C T' (unknowns x 12)
  const Eigen::MatrixXd response =
      at.scale.asDiagonal() * at.llt.solve(at.scale.asDiagonal() * rows.transpose());
  const Covariance12 covariance = rows * response + beyond;
  out.covariance = 0.5 * (covariance + covariance.transpose());
  out.gain = at.whitened_jacobian * response;
  at.whitener->whiten_transposed(out.gain);
  if (at.tau > 0.0) out.gain.rightCols<3>() += mean_weights;

  out.shares.assign(groups.groups.size(), Covariance12::Zero());
  for (std::size_t i = 0; i < groups.of_unknown.size(); ++i) {
    if (groups.of_unknown[i] < 0) continue;
    const auto row = response.row(static_cast<Eigen::Index>(i));
    out.shares[static_cast<std::size_t>(groups.of_unknown[i])].noalias() +=
        model.prior_weight()(static_cast<Eigen::Index>(i)) * row.transpose() * row;
  }
  if (groups.first_step < 0) return out;
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(at.white);
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const Vector12 by_f = out.gain.middleRows<3>(3 * static_cast<Eigen::Index>(n)).transpose() *
                          angles[n].by_step * model.step_sd();
    out.shares[static_cast<std::size_t>(groups.first_step + model.experiment_of(n) - 1)].noalias() +=
        by_f * by_f.transpose();
  }
  return out;
}

/// White noise of each output in units of u, and the degrees of freedom that it is known with.
struct WhiteFound {
  Eigen::Vector3d white = Eigen::Vector3d::Ones();
  Eigen::Vector3d redundancy = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
};

/// Repeated until the weighted squares of the residuals equal their expectation (restricted likelihood).
WhiteFound estimate_white(const EffectModel& model) {
  WhiteFound found;
  Eigen::Vector3d& white = found.white;
  for (int pass = 0; pass < kWhitePasses; ++pass) {
    const AtNoise at = solve_at(model, 0.0, 1.0, white);
    // P = V^-1 - V^-1 J C J' V^-1: sums of its squared products with the noise of each output.
    ReadingRows product = at.whitened_residual;
    at.whitener->whiten_transposed(product);
    ReadingRows spread = at.whitened_jacobian * at.covariance_root();
    at.whitener->whiten_transposed(spread);
    const std::vector<NoiseAtAngle> angles = model.noise_at_angles(white);
    Eigen::Vector3d squares = Eigen::Vector3d::Zero();
    Eigen::Vector3d& redundancy = found.redundancy;
    redundancy.setZero();
    for (std::size_t n = 0; n < angles.size(); ++n) {
      Eigen::Matrix3d v =
          model.step_sd() * model.step_sd() * angles[n].by_step * angles[n].by_step.transpose();
      v.diagonal() += angles[n].white;
      const Eigen::Matrix3d inverse = v.llt().solve(Eigen::Matrix3d::Identity());
      for (int j = 0; j < 3; ++j) {
        const auto row = static_cast<Eigen::Index>(3 * n) + j;
        squares(j) += angles[n].white(j) * product(row, 0) * product(row, 0);
        redundancy(j) += angles[n].white(j) * (inverse(j, j) - spread.row(row).squaredNorm());
      }
    }
    if (!(redundancy.minCoeff() >= 0.5)) {
      throw UnusableData(
          fmt::format("{} angles leave nothing to estimate the noise from; more angles or the uncertainties "
                      "of the readings are required",
                      angles.size()));
    }
    const Eigen::Vector3d before = white;
    white = white.cwiseProduct(squares.cwiseQuotient(redundancy).cwiseSqrt()).cwiseMax(model.least_white());
    if ((white.cwiseQuotient(before).array() - 1.0).abs().maxCoeff() < kWhiteFound) break;
  }
  return found;
}

/// The noises that are probable, with their probabilities; white noise alone stands first.
struct NoiseSearch {
  WhiteFound white;
  std::vector<AtNoise> points;
  std::vector<double> weights;
  std::size_t best() const {
    return static_cast<std::size_t>(std::max_element(weights.begin(), weights.end()) - weights.begin());
  }
};

NoiseSearch search_noise(const EffectModel& model) {
  NoiseSearch out;
  if (!model.options().white_known) out.white = estimate_white(model);
  const Eigen::Vector3d white = out.white.white;
  out.points.push_back(solve_at(model, 0.0, 1.0, white));
  out.weights.push_back(std::log(0.5));
  const double prior = std::log(0.5 / static_cast<double>(kTauGrid.size() * kRhoGrid.size()));
  for (const double tau : kTauGrid) {
    if (!model.options().noise_process) break;
    double best_of_tau = -std::numeric_limits<double>::infinity();
    for (const double rho : kRhoGrid) {
      AtNoise point = solve_at(model, tau, rho, white);
      const double gain = point.log_likelihood - out.points.front().log_likelihood + prior;
      best_of_tau = std::max(best_of_tau, gain);
      if (gain < std::log(kNegligibleWeight) || !std::isfinite(gain)) continue;
      out.points.push_back(std::move(point));
      out.weights.push_back(gain);
    }
    // Larger processes are less likely still.
    if (tau > 0.5 && best_of_tau < *std::max_element(out.weights.begin(), out.weights.end()) - 20.0) break;
  }
  const double largest = *std::max_element(out.weights.begin(), out.weights.end());
  double sum = 0.0;
  for (double& weight : out.weights) sum += weight = std::exp(weight - largest);
  for (double& weight : out.weights) weight /= sum;
  return out;
}

/// The line response averaged over the noises. @return that of the most probable one
LineAtNoise average_line(const EffectModel& model, const NoiseSearch& search, EffectFit& fit) {
  ShareGroups groups = share_groups(model);
  std::vector<LineAtNoise> lines;
  Vector12 mean = Vector12::Zero();
  Covariance12 covariance = Covariance12::Zero();
  for (std::size_t i = 0; i < search.points.size(); ++i) {
    const double weight = search.weights[i];
    const LineAtNoise& line = lines.emplace_back(line_at(model, search.points[i], groups));
    mean += weight * line.change;
    covariance += weight * line.covariance;
    for (std::size_t g = 0; g < groups.groups.size(); ++g)
      groups.groups[g].covariance += weight * line.shares[g];
  }
  Vector12 spread_of_variance = Vector12::Zero();
  const Vector12 variance = covariance.diagonal();
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const Vector12 off = lines[i].change - mean;
    covariance += search.weights[i] * off * off.transpose();
    spread_of_variance += search.weights[i] * (lines[i].covariance.diagonal() - variance).cwiseAbs2();
  }
  for (Eigen::Index i = 0; i < 12; ++i) {
    if (spread_of_variance(i) > 1e-12 * variance(i) * variance(i))
      fit.degrees_of_freedom(i) = 2.0 * variance(i) * variance(i) / spread_of_variance(i);
  }
  fit.line = model.line_values() + mean;
  fit.covariance_line = covariance;
  fit.covariance_line_type_b.setZero();
  for (const EffectShare& share : groups.groups) fit.covariance_line_type_b += share.covariance;
  fit.shares = std::move(groups.groups);
  return std::move(lines[search.best()]);
}

/// The variance of an output's estimated white noise is known to 2/nu (relative, squared).
void add_degrees_of_estimated_noise(const EffectModel& model, const WhiteFound& found,
                                    const ReadingRows& gain, EffectFit& fit) {
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(found.white);
  Eigen::Matrix<double, 12, 3> by_output = Eigen::Matrix<double, 12, 3>::Zero();
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const auto three = gain.middleRows<3>(3 * static_cast<Eigen::Index>(n));
    for (int j = 0; j < 3; ++j) by_output.col(j) += angles[n].white(j) * three.row(j).transpose().cwiseAbs2();
  }
  for (Eigen::Index i = 0; i < 12; ++i) {
    const double variance2 = std::pow(fit.covariance_line(i, i), 2);
    double spread =
        std::isfinite(fit.degrees_of_freedom(i)) ? 2.0 * variance2 / fit.degrees_of_freedom(i) : 0.0;
    for (int j = 0; j < 3; ++j) spread += 2.0 * by_output(i, j) * by_output(i, j) / found.redundancy(j);
    if (spread > 0.0) fit.degrees_of_freedom(i) = 2.0 * variance2 / spread;
  }
}

/// Step errors with their standard uncertainties, and residuals, at the most probable noise.
void fill_residuals(const EffectModel& model, const AtNoise& best, const Eigen::MatrixXd& root,
                    EffectFit& fit) {
  const std::size_t count = model.angles();
  fit.residuals.resize(count);
  fit.whitened.resize(count);
  fit.step_error.assign(count, 0.0);
  fit.u_step_error.assign(count, 0.0);
  ReadingRows left = best.whitened_residual;
  best.whitener->whiten_transposed(left);
  const Eigen::VectorXd shift = model.jacobian() * best.change;
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(best.white);
  const double variance = model.step_sd() * model.step_sd();
  // Var(f) = step^2 - step^4 v' P v, with P of all readings; the process's part of V^-1 is left out.
  ReadingRows links(static_cast<Eigen::Index>(count), root.rows());
  Eigen::VectorXd known(static_cast<Eigen::Index>(count));
  for (std::size_t n = 0; n < count; ++n) {
    const auto at = static_cast<Eigen::Index>(n);
    const Eigen::Vector3d v = angles[n].by_step;
    Eigen::Matrix3d local = variance * v * v.transpose();
    local.diagonal() += angles[n].white;
    const Eigen::Vector3d weight = local.llt().solve(v);
    known(at) = v.dot(weight);
    links.row(at).noalias() = weight.transpose() * model.jacobian().middleRows<3>(3 * at);
  }
  const ReadingRows spread = links * root.triangularView<Eigen::Upper>();
  for (std::size_t n = 0; n < count; ++n) {
    const auto at = static_cast<Eigen::Index>(n);
    const Eigen::Vector3d v = angles[n].by_step;
    const double f = variance * v.dot(left.col(0).segment<3>(3 * at));
    const double u2 = variance - variance * variance * (known(at) - spread.row(at).squaredNorm());
    fit.step_error[n] = f;
    fit.u_step_error[n] = std::sqrt(std::max(0.0, u2));
    if (const int map = model.map_of(n); map >= 0) {
      const Eigen::Index place = model.layout().first_map() + map;
      fit.step_error[n] = fit.value(place);
      fit.u_step_error[n] = std::sqrt(fit.covariance(place, place));
    }
    fit.residuals[n] =
        (model.residual().segment<3>(3 * at) - shift.segment<3>(3 * at) - v * f).cwiseProduct(model.unit());
    fit.whitened[n] = best.whitened_residual.segment<3>(3 * at);
  }
}

/// From relative units to those of the readings.
void restore_units(EffectFit& fit) {
  Vector12 units;
  for (int j = 0; j < 3; ++j) {
    units.segment<3>(3 * j).setConstant(fit.unit(j));
    units(9 + j) = fit.unit(j);
  }
  const auto in_units = [&](Covariance12& covariance) {
    covariance = units.asDiagonal() * covariance * units.asDiagonal();
  };
  for (Eigen::Index row = 0; row < fit.gain.rows(); ++row)
    fit.gain.row(row) = fit.gain.row(row).cwiseProduct(units.transpose()) / fit.unit(row % 3);
  fit.line = fit.line.cwiseProduct(units);
  in_units(fit.covariance_line);
  in_units(fit.covariance_line_type_b);
  for (EffectShare& share : fit.shares) in_units(share.covariance);
}

}  // namespace

EffectFit effect_fit(std::span<const EffectReading> readings, const EffectFitOptions& options) {
  EffectFit fit;
  EffectModel model(readings, options);
  if (!model.solve(fit)) return fit;
  NoiseSearch search = search_noise(model);
  LineAtNoise line = average_line(model, search, fit);
  AtNoise& best = search.points[search.best()];

  fit.noise.process_probability = 1.0 - search.weights.front();
  fit.noise.tau = best.tau;
  fit.noise.rho = best.rho;
  fit.noise.white = best.white;
  fit.noise.white_estimated = !options.white_known;
  fit.unknowns = model.unknowns();
  fit.unit = model.unit();
  fit.value = model.value() + best.change;
  fit.covariance_root = best.covariance_root();
  fit.covariance = products_of_columns(fit.covariance_root.transpose());
  fit.chi2 = best.chi2;
  fit.chi2_degrees_of_freedom = 3 * static_cast<int>(readings.size()) - 12;
  if (!options.white_known) add_degrees_of_estimated_noise(model, search.white, line.gain, fit);
  fill_residuals(model, best, fit.covariance_root, fit);
  fit.left_out_design = model.left_out_columns(fit.left_out);
  best.whitener->whiten(fit.left_out_design);
  fit.gain = std::move(line.gain);
  fit.whitened_jacobian = std::move(best.whitened_jacobian);
  restore_units(fit);
  return fit;
}

}  // namespace abcal
