#include "app/results/export/constants.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "protocol/estimators/checks/comparison.h"
#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

/// The numbers that M and b are made of: s row by row in the axes of a frame (R/g_loc), and the offsets (R).
struct Inputs {
  Eigen::Matrix3d S;
  Covariance12 covariance;
};

/// Derivatives of the sensitivity in the item's own axes, row by row, by s_u, s_v, s_w, phi_uv, phi_vw,
/// phi_wu.
Eigen::Matrix<double, 9, 6> derivatives_in_own_axes(const Eigen::Matrix<double, 6, 1>& value) {
  Eigen::Matrix<double, 9, 6> derivatives;
  for (Eigen::Index i = 0; i < 6; ++i) {
    Eigen::Matrix<double, 6, 1> up = value, down = value;
    const double step = 1e-6 * std::max(1.0, std::abs(value[i]));
    up[i] += step;
    down[i] -= step;
    const Eigen::Matrix3d difference = (sensitivity_in_own_axes(up.head<3>(), up.tail<3>()) -
                                        sensitivity_in_own_axes(down.head<3>(), down.tail<3>())) /
                                       (2.0 * step);
    for (Eigen::Index k = 0; k < 9; ++k) derivatives(k, i) = difference(k / 3, k % 3);
  }
  return derivatives;
}

Inputs inputs_of(const CalibrationResult& result, ExportFrame frame) {
  if (frame == ExportFrame::kItem) {
    if (!result.covariance_intrinsic) throw std::invalid_argument("the result has no covariance");
    const Eigen::Matrix<double, 6, 1> own = intrinsic_values(result).head<6>();
    Eigen::Matrix<double, 12, 9> derivatives = Eigen::Matrix<double, 12, 9>::Zero();
    derivatives.topLeftCorner<9, 6>() = derivatives_in_own_axes(own);
    derivatives.bottomRightCorner<3, 3>().setIdentity();
    return {sensitivity_in_own_axes(own.head<3>(), own.tail<3>()),
            derivatives * *result.covariance_intrinsic * derivatives.transpose()};
  }
  if (!result.sensitivity_matrix || !result.covariance) {
    throw std::invalid_argument(fmt::format(
        "the {} estimator knows no platter; required: --frame item, or another estimator", result.estimator));
  }
  return {result.sensitivity_values(), *result.covariance};
}

}  // namespace

Eigen::Matrix3d sensitivity_in_own_axes(const Eigen::Vector3d& sensitivity,
                                        const Eigen::Vector3d& angle_deg) {
  const auto cosine = [&](Eigen::Index k) { return std::cos(angle_deg[k] * std::numbers::pi / 180.0); };
  Eigen::Matrix3d gram;
  gram << 1.0, cosine(0), cosine(2),  //
      cosine(0), 1.0, cosine(1),      //
      cosine(2), cosine(1), 1.0;
  const Eigen::LLT<Eigen::Matrix3d> directions(gram);
  if (directions.info() != Eigen::Success)
    throw std::invalid_argument("the axes of the accelerometers lie in one plane");
  return sensitivity.asDiagonal() * Eigen::Matrix3d(directions.matrixL());
}

CorrectionMatrix correction_matrix(const Eigen::Matrix3d& S, double g_loc_mps2) {
  const Eigen::PartialPivLU<Eigen::Matrix3d> solver(S);
  constexpr double kLeastCondition = 1e-12;  // Below it the elements of M have no digits left.
  if (!(solver.rcond() > kLeastCondition))
    throw std::invalid_argument(
        fmt::format("the sensitivity matrix is singular (reciprocal condition {:.1e}), so that the outputs "
                    "do not determine an acceleration",
                    solver.rcond()));
  CorrectionMatrix correction;
  correction.M = g_loc_mps2 * solver.solve(Eigen::Matrix3d::Identity());
  const Eigen::Matrix3d& M = correction.M;
  // dM = -M dS M / g_loc
  for (Eigen::Index row = 0; row < 9; ++row) {
    for (Eigen::Index of = 0; of < 9; ++of)
      correction.derivatives(row, of) = -M(row / 3, of / 3) * M(of % 3, row % 3) / g_loc_mps2;
    correction.derivatives(row, 9) = M(row / 3, row % 3) / g_loc_mps2;
  }
  return correction;
}

Eigen::Matrix3d CorrectionConstants::u_matrix() const {
  return Eigen::Matrix3d::NullaryExpr([&](Eigen::Index i, Eigen::Index j) {
    return std::sqrt(std::max(0.0, covariance(3 * i + j, 3 * i + j)));
  });
}

Eigen::Vector3d CorrectionConstants::u_b() const {
  return covariance.diagonal().tail<3>().cwiseMax(0.0).cwiseSqrt();
}

Eigen::Matrix3d CorrectionConstants::matrix_si() const {
  if (!unit_mps2) {
    throw std::invalid_argument(
        fmt::format("the output is in {}, this format takes accelerations; required: an output in g, mg or "
                    "m/s2, or the formats json, csv, mat, c",
                    response_unit));
  }
  return M / *unit_mps2;
}

Eigen::Vector3d CorrectionConstants::bias_si() const {
  return b * unit_mps2.value_or(std::nan(""));
}

double CorrectionConstants::diagonal_remainder_mps2() const {
  const Eigen::Matrix3d si = matrix_si();
  double worst = 0.0;
  for (Eigen::Index j = 0; j < 3; ++j) {
    Eigen::Vector3d row = si.row(j).transpose();
    row[j] = 0.0;
    worst = std::max(worst, row.norm());
  }
  return worst * g_loc_mps2;
}

CorrectionConstants constants_of(const CalibrationResult& result, ExportFrame frame) {
  if (result.verdict == Verdict::kNotUsable)
    throw std::invalid_argument(
        fmt::format("the result of {} is not usable: {}", result.estimator, result.why));
  if (!std::isfinite(result.g_loc.value)) {
    throw std::invalid_argument(
        "local gravity is not known, so that accelerations are not; required: a run, or a table with the "
        "line \"# g_loc.value_mps2: 9.81...\" (`abcal gravity` computes it)");
  }
  CorrectionConstants constants;
  constants.frame = frame;
  constants.response_unit = result.response_unit;
  constants.unit_mps2 = acceleration_unit_mps2(result.response_unit);
  constants.g_loc_mps2 = result.g_loc.value;
  const Inputs inputs = inputs_of(result, frame);
  const CorrectionMatrix correction = correction_matrix(inputs.S, result.g_loc.value);
  constants.M = correction.M;
  constants.b = result.offset_values();
  Covariance12 derivatives = Covariance12::Zero();
  derivatives.topLeftCorner<9, 9>() = correction.derivatives.leftCols<9>();
  derivatives.bottomRightCorner<3, 3>().setIdentity();
  constants.covariance = derivatives * inputs.covariance * derivatives.transpose();
  if (const double u = result.g_loc.standard_uncertainty; std::isfinite(u)) {
    const Eigen::Matrix<double, 9, 1> by_gravity = u * correction.derivatives.col(9);
    constants.covariance.topLeftCorner<9, 9>() += by_gravity * by_gravity.transpose();
  }
  constants.source = fmt::format("{}, {} estimator", result.source, result.estimator);
  constants.verdict = to_string(result.verdict);
  for (NamedQuantity& output : outputs(result))
    if (std::isfinite(output.quantity.value)) constants.outputs.push_back(std::move(output));
  return constants;
}

}  // namespace abcal
