#include "protocol/estimators/shared/known_acs_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/estimators/shared/known_acs_sums.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/model/stage_model.h"

namespace abcal {

KnownAcsFit linear_fit_given_acs(std::span<const Eigen::Vector3d> gravity,
                                 std::span<const Eigen::Vector3d> readings, std::span<const double> weights) {
  if (gravity.size() != readings.size() || (!weights.empty() && weights.size() != readings.size())) {
    throw std::invalid_argument("fit with known stage errors: " + std::to_string(gravity.size()) +
                                " forces, " + std::to_string(readings.size()) + " readings, " +
                                std::to_string(weights.size()) +
                                " weights; one of each is required at every angle");
  }
  KnownAcsSums sums;
  for (std::size_t i = 0; i < readings.size(); ++i) {
    const double w = weights.empty() ? 1.0 : weights[i];
    if (!(w >= 0.0) || !std::isfinite(w)) {
      throw std::invalid_argument("fit with known stage errors: weight " + std::to_string(i + 1) + " is " +
                                  std::to_string(w) + "; a finite number >= 0 is required");
    }
    sums.add(gravity[i], readings[i], w);
  }
  return fit_of_sums(sums, readings.size());
}

KnownAcsFit fit_of_sums(const KnownAcsSums& sums, std::size_t readings) {
  const auto& [normal, right] = sums;
  if (!normal.allFinite() || !right.allFinite()) {
    throw std::invalid_argument("fit with known stage errors: a force or reading is not a finite number");
  }
  const Eigen::LDLT<Eigen::Matrix4d> ldlt(normal);
  const Eigen::Vector4d pivots = ldlt.vectorD();
  KnownAcsFit fit;
  fit.reciprocal_condition = pivots.maxCoeff() > 0.0 ? pivots.minCoeff() / pivots.maxCoeff() : 0.0;
  // Pivots of a singular 4x4 matrix are round-off: a few ulp of the largest.
  if (!(fit.reciprocal_condition > 64.0 * std::numeric_limits<double>::epsilon())) {
    throw UnusableData("fit with known stage errors: " + std::to_string(readings) +
                       " readings do not determine sensitivity and offset; required: poses that turn gravity "
                       "out of one plane");
  }
  const Eigen::Matrix<double, 4, 3> solution = ldlt.solve(right);
  fit.sensitivity_matrix = solution.topRows<3>().transpose();
  fit.offset = solution.row(3).transpose();
  fit.cofactor = ldlt.solve(Eigen::Matrix4d::Identity());
  return fit;
}

KnownAcsFit linear_fit_given_acs(const RunRecord& record, const AcsErrors& errors) {
  std::array<GravityCircle, 3> circles;
  for (std::size_t i = 0; i < 3; ++i) circles[i] = gravity_circle(static_cast<int>(i) + 1, errors);
  std::vector<Eigen::Vector3d> gravity;
  std::vector<Eigen::Vector3d> readings;
  std::vector<double> weights;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing) continue;
    const Angle actual = dwell.alpha + errors.rotation_error(dwell.experiment, dwell.n);
    gravity.push_back(circles[static_cast<std::size_t>(dwell.experiment - 1)].at(actual));
    readings.push_back(dwell.mean);
    const double u2 = dwell.u_mean ? dwell.u_mean->squaredNorm() / 3.0 : 0.0;
    if (u2 > 0.0) weights.push_back(1.0 / u2);
  }
  if (weights.size() != readings.size()) weights.clear();  // not known everywhere: all alike
  return linear_fit_given_acs(gravity, readings, weights);
}

KnownAcsFit linear_fit_on_perfect_stage(std::span<const DwellRecord* const> dwells) {
  std::vector<Eigen::Vector3d> gravity, readings;
  for (const DwellRecord* dwell : dwells) {
    const SinCos alpha = sincos(dwell->alpha);
    gravity.push_back(gravity_alone(StagePose::of(dwell->experiment, dwell->face, alpha.sin, alpha.cos),
                                    StageInputs::Zero()));
    readings.push_back(dwell->mean);
  }
  return linear_fit_given_acs(gravity, readings);
}

}  // namespace abcal
