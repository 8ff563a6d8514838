#include "protocol/estimators/joint/effect_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/effect_solution.h"
#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/joint/noise_search.h"
#include "protocol/estimators/joint/size_evidence.h"
#include "protocol/estimators/joint/white_noise_fit.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

LineAtNoise line_at(const EffectModel& model, const AtNoise& at, const ShareGroups& groups) {
  LineAtNoise out;
  Rows12 rows = model.line_rows();
  Covariance12 beyond = Covariance12::Zero();
  out.change = product_with_vector(rows, at.change);
  ReadingRows mean_weights;  // V^-1 cov(readings, means of the process)
  if (at.noise.tau > 0.0) {
    // The mean of the process over the run belongs to the offset.
    mean_weights = at.whitener->covariance_with_mean();
    at.whitener->whiten(mean_weights);
    out.change.tail<3>() += transposed_product_by_rows_with_vector(mean_weights, at.whitened_residual);
    rows.bottomRows<3>() -= transposed_product_by_rows(mean_weights, at.whitened_jacobian);
    beyond.bottomRightCorner<3, 3>() = -products_of_columns(mean_weights);
    beyond.bottomRightCorner<3, 3>().diagonal() += at.whitener->mean_variance();
    at.whitener->whiten_transposed(mean_weights);
  }
  // C T' (unknowns x 12)
  const Eigen::MatrixXd response = at.normal.solve_columns(rows.transpose());
  const Covariance12 covariance = product(rows, response) + beyond;
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
  add_share_of_signs(model, groups, out);
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
  const Eigen::MatrixXd taken = transposed_product_by_rows(design, links);
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
    const double factor = model.step_factor(n);
    fit.step_error[n] = factor * f;
    fit.u_step_error[n] = factor * std::sqrt(std::max(0.0, u2));
    fit.step_factor.push_back(factor);
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

}  // namespace

EffectSolution solve_effects(std::span<const EffectReading> readings, const EffectFitOptions& options) {
  EffectSolution out;
  EffectFit& fit = out.fit;
  EffectModel& model = out.model.emplace(readings, options);
  const WhiteNoiseFit white = fit_with_white_noise(model);
  fit.converged = white.minimum.found;
  fit.iterations = white.minimum.iterations;
  fit.reciprocal_condition = white.reciprocal_condition;
  if (!fit.converged) return out;
  NoiseSearch search = search_noise(model);
  if (search.points[search.best()].noise.tau > 0.0) fit.larger_sizes = size_evidence(model, search);
  const ShareGroups groups = share_groups(model);
  std::vector<LineAtNoise> lines;
  for (std::size_t i = 0; i < search.points.size(); ++i) {
    lines.push_back(line_at(model, search.points[i], groups));
    out.noises.push_back(search.points[i].noise);
    out.weights.push_back(search.weight(i));
    out.log_likelihoods.push_back(search.points[i].log_likelihood);
  }
  out.white = search.white;
  average_line(model.line_values(), groups, lines, out.weights, fit);
  if (options.white_known) keep_stated_noise(lines.front(), fit);
  AtNoise& best = search.points[search.best()];
  LineAtNoise& line = lines[search.best()];

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
  return out;
}

EffectFit effect_fit(std::span<const EffectReading> readings, const EffectFitOptions& options) {
  return std::move(solve_effects(readings, options).fit);
}

}  // namespace abcal
