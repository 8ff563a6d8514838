#include "protocol/estimators/joint/held_out_norm.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_solution.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/products.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// Deviations of |a| from 1 at one pose.
struct Deviation {
  double of_line = 0.0;   ///< By the customer's equation.
  double of_model = 0.0;  ///< With the fitted non-linearity and drift.
  double u = 0.0;         ///< Standard uncertainty of of_model.
};

/// |a| - 1 by a = M (r - b) with the line response of a fit.
double of_line(const EffectFit& fit, const Eigen::Vector3d& reading) {
  Eigen::Matrix3d s;
  for (Eigen::Index j = 0; j < 3; ++j) s.row(j) = fit.line.segment<3>(3 * j).transpose();
  return s.partialPivLu().solve(reading - fit.line.tail<3>()).norm() - 1.0;
}

/// The poses of one fold, predicted by the solution of the others.
std::vector<Deviation> predict(const std::vector<EffectReading>& all, const EffectSolution& without,
                               const EffectFitOptions& options, const std::vector<std::size_t>& held_out) {
  const EffectFit& fit = without.fit;
  EffectModel model(all, options);
  model.move_to(*without.model, std::vector<double>(all.size(), 0.0));
  if (model.layout().count() == fit.covariance_root.rows()) model.take_signs(fit.covariance_root);
  const Eigen::Index item = model.layout().first_stage();
  const int own = model.layout().own_count();
  const std::vector<NoiseAtAngle> noise = model.noise_at_angles(fit.noise.white);
  // The noise process moves the solution a little from that with white noise, where the model is.
  const Eigen::VectorXd moved = (fit.value - without.model->value()).head(item);
  const Eigen::Vector3d process = model.process_of(fit.noise.tau, fit.noise.rho).tau;
  std::vector<Deviation> out;
  for (const std::size_t n : held_out) {
    const auto first = 3 * static_cast<Eigen::Index>(n);
    const Eigen::Vector3d g = model.gravity(n).g;
    const auto jacobian = model.jacobian().middleRows<3>(first);
    Eigen::Matrix3d slope;  // Derivatives of the readings by the linear responses of u, v, w; |g| is 1.
    for (Eigen::Index m = 0; m < 3; ++m) slope.col(m) = jacobian.middleCols<3>(own * m) * g;
    const Eigen::Matrix3d by_g = slope * model.rows();
    // Along g only: an error of the stage turns it.
    const Eigen::RowVector3d along = by_g.transpose().partialPivLu().solve(g).transpose();
    const Eigen::RowVectorXd by_item = along * jacobian.leftCols(item);
    Deviation one;
    one.of_line = of_line(fit, all[n].value);
    one.of_model = along.dot(model.residual().segment<3>(first).transpose()) - by_item.dot(moved);
    const double variance =
        along.cwiseAbs2().dot(noise[n].white + process.cwiseAbs2()) +
        transposed_product(fit.covariance_root.topRows(item), by_item.transpose()).squaredNorm();
    one.u = std::sqrt(variance);
    out.push_back(one);
  }
  return out;
}

HeldOutNorm summary(const std::vector<std::vector<Deviation>>& folds) {
  HeldOutNorm out;
  out.folds = static_cast<int>(folds.size());
  double line = 0.0, model = 0.0, expected = 0.0, in_u = 0.0;
  for (const std::vector<Deviation>& fold : folds) {
    for (const Deviation& one : fold) {
      ++out.poses;
      line += one.of_line * one.of_line;
      out.largest = std::max(out.largest, std::abs(one.of_line));
      model += one.of_model * one.of_model;
      expected += one.u * one.u;
      in_u += std::pow(one.of_model / one.u, 2);
    }
  }
  const auto count = static_cast<double>(out.poses);
  out.rms = std::sqrt(line / count);
  out.rms_of_model = std::sqrt(model / count);
  out.rms_expected = std::sqrt(expected / count);
  out.rms_in_u = std::sqrt(in_u / count);
  // The noise of the poses governs, and each has its own.
  out.probability = chi2_tail(in_u, out.poses);
  return out;
}

}  // namespace

HeldOutNorm held_out_norm(const RunRecord& record, const JointOptions& options, int folds) {
  const CollectedReadings data = collect_readings(record, options.one_map_per_axis);
  EffectFitOptions fit_options{.sizes = record.tolerances,
                               .measured_alignment = options.measured_alignment,
                               .nonlinearity = options.nonlinearity == Nonlinearity::kFitted,
                               .drift = options.drift,
                               .mean_step = options.mean_step,
                               .noise_process = options.noise_process,
                               .white_known = data.u_known};
  const auto count = static_cast<std::size_t>(folds);
  std::vector<std::vector<Deviation>> found(count);
  std::vector<char> failed(count, 0);
  side_by_side(count, [&](std::size_t fold) {
    std::vector<EffectReading> used;
    std::vector<std::size_t> held_out;
    for (std::size_t n = 0; n < data.readings.size(); ++n) {
      if (n % count == fold) {
        held_out.push_back(n);
      } else {
        used.push_back(data.readings[n]);
      }
    }
    try {
      const EffectSolution solution = solve_effects(used, fit_options);
      if (solution.fit.converged) {
        found[fold] = predict(data.readings, solution, fit_options, held_out);
        return;
      }
    } catch (const UnusableData&) {
      // Too few angles without the fold.
    }
    failed[fold] = 1;
  });
  for (const char one : failed)
    if (one != 0) return {};
  return summary(found);
}

}  // namespace abcal
