#include "protocol/analysis/effect_fit.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>

#include "protocol/analysis/effect_model.h"
#include "protocol/analysis/noise_search.h"
#include "protocol/analysis/reading_kernels.h"
#include "protocol/analysis/size_evidence.h"

namespace abcal {
namespace {

constexpr std::array<const char*, 3> kStepGroups{"f_1", "f_2", "f_3"};

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

LineAtNoise line_at(const EffectModel& model, const AtNoise& at, const ShareGroups& groups) {
  LineAtNoise out;
  Rows12 rows = model.line_rows();
  Covariance12 beyond = Covariance12::Zero();
  out.change = rows * at.change;
  ReadingRows mean_weights;  // V^-1 cov(readings, means of the process)
  if (at.noise.tau > 0.0) {
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
  const Eigen::MatrixXd response = at.normal.solve_columns(rows.transpose());
  const Covariance12 covariance = rows * response + beyond;
  out.covariance = 0.5 * (covariance + covariance.transpose());
  out.gain = times(at.whitened_jacobian, response);
  at.whitener->whiten_transposed(out.gain);
  if (at.noise.tau > 0.0) out.gain.rightCols<3>() += mean_weights;

  out.shares.assign(groups.groups.size(), Covariance12::Zero());
  for (std::size_t i = 0; i < groups.of_unknown.size(); ++i) {
    if (groups.of_unknown[i] < 0) continue;
    const auto row = response.row(static_cast<Eigen::Index>(i));
    out.shares[static_cast<std::size_t>(groups.of_unknown[i])].noalias() +=
        model.prior_weight()(static_cast<Eigen::Index>(i)) * row.transpose() * row;
  }
  if (groups.first_step < 0) return out;
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(at.noise.white);
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const Vector12 by_f = out.gain.middleRows<3>(3 * static_cast<Eigen::Index>(n)).transpose() *
                          angles[n].by_step * model.step_sd();
    out.shares[static_cast<std::size_t>(groups.first_step + model.experiment_of(n) - 1)].noalias() +=
        by_f * by_f.transpose();
  }
  return out;
}

/// The line response averaged over the noises. @return that of the most probable one
LineAtNoise average_line(const EffectModel& model, const NoiseSearch& search, EffectFit& fit) {
  ShareGroups groups = share_groups(model);
  std::vector<LineAtNoise> lines;
  Vector12 mean = Vector12::Zero();
  Covariance12 covariance = Covariance12::Zero();
  for (std::size_t i = 0; i < search.points.size(); ++i) {
    const double weight = search.weight(i);
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
    covariance += search.weight(i) * off * off.transpose();
    spread_of_variance += search.weight(i) * (lines[i].covariance.diagonal() - variance).cwiseAbs2();
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

/// v' P v of each step error, with v its effect on the readings and P = V^-1 - V^-1 J C J' V^-1: the variance
/// of f is step^2 - step^4 v' P v. With white noise V has a block for each angle.
Eigen::VectorXd told_of_steps(const EffectModel& model, const std::vector<NoiseAtAngle>& angles,
                              const Eigen::MatrixXd& root) {
  const auto count = static_cast<Eigen::Index>(angles.size());
  const double variance = model.step_sd() * model.step_sd();
  ReadingRows links(count, root.rows());
  Eigen::VectorXd known(count);
  for (Eigen::Index n = 0; n < count; ++n) {
    const NoiseAtAngle& angle = angles[static_cast<std::size_t>(n)];
    const Eigen::Vector3d v = angle.by_step;
    Eigen::Matrix3d local = variance * v * v.transpose();
    local.diagonal() += angle.white;
    const Eigen::Vector3d weight = local.llt().solve(v);
    known(n) = v.dot(weight);
    links.row(n).noalias() = weight.transpose() * model.jacobian().middleRows<3>(3 * n);
  }
  const ReadingRows taken = times_upper(links, root);
  return known - taken.rowwise().squaredNorm();
}

/// The same with a process, which links all angles.
Eigen::VectorXd told_of_steps_with_process(const AtNoise& best, const std::vector<NoiseAtAngle>& angles,
                                           const Eigen::MatrixXd& root) {
  const auto count = static_cast<Eigen::Index>(angles.size());
  ReadingRows links = ReadingRows::Zero(3 * count, count);
  for (Eigen::Index n = 0; n < count; ++n)
    links.block<3, 1>(3 * n, n) = angles[static_cast<std::size_t>(n)].by_step;
  best.whitener->whiten(links);
  const ReadingRows design = times_upper(best.whitened_jacobian, root);
  const Eigen::MatrixXd taken = design.transpose() * links;
  return (links.colwise().squaredNorm() - taken.colwise().squaredNorm()).transpose();
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
  const std::vector<NoiseAtAngle> angles = model.noise_at_angles(best.noise.white);
  const double variance = model.step_sd() * model.step_sd();
  const Eigen::VectorXd told = best.noise.tau > 0.0 ? told_of_steps_with_process(best, angles, root)
                                                    : told_of_steps(model, angles, root);
  for (std::size_t n = 0; n < count; ++n) {
    const auto at = static_cast<Eigen::Index>(n);
    const Eigen::Vector3d v = angles[n].by_step;
    const double f = variance * v.dot(left.col(0).segment<3>(3 * at));
    const double u2 = variance - variance * variance * told(at);
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
  if (search.points[search.best()].noise.tau > 0.0) fit.larger_sizes = size_evidence(model, search);
  LineAtNoise line = average_line(model, search, fit);
  AtNoise& best = search.points[search.best()];

  fit.noise.process_probability = 1.0 - search.weight(0);
  fit.noise.tau = best.noise.tau;
  fit.noise.rho = best.noise.rho;
  fit.noise.white = best.noise.white;
  fit.noise.white_estimated = !options.white_known;
  fit.unknowns = model.unknowns();
  fit.unit = model.unit();
  fit.value = model.value() + best.change;
  fit.covariance_root = best.normal.covariance_root();
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
