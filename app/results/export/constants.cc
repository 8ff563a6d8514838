#include "app/results/export/constants.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "protocol/estimators/checks/comparison.h"
#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

/// The nine numbers that a frame's matrix is made of: s, phi for the item's; s row by row for the platter's.
struct Inputs {
  Eigen::Matrix<double, 9, 1> value;
  Eigen::Matrix<double, 9, 9> covariance;
};

Eigen::Matrix3d matrix_of(ExportFrame frame, const Eigen::Matrix<double, 9, 1>& x) {
  if (frame == ExportFrame::kItem) return sensitivity_in_own_axes(x.head<3>(), x.segment<3>(3));
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(x.data());
}

Inputs inputs_of(const CalibrationResult& result, ExportFrame frame) {
  Inputs inputs;
  if (frame == ExportFrame::kItem) {
    inputs.value = intrinsic_values(result);
    if (!result.covariance_intrinsic) throw std::invalid_argument("the result has no covariance");
    inputs.covariance = *result.covariance_intrinsic;
    return inputs;
  }
  if (!result.sensitivity_matrix || !result.covariance) {
    throw std::invalid_argument(fmt::format(
        "the {} estimator knows no platter; required: --frame item, or another estimator", result.estimator));
  }
  const Eigen::Matrix3d s = result.sensitivity_values();
  for (Eigen::Index k = 0; k < 9; ++k) inputs.value[k] = s(k / 3, k % 3);
  inputs.covariance = result.covariance->topLeftCorner<9, 9>();
  return inputs;
}

Eigen::Matrix3d inverse_of(const Eigen::Matrix3d& S) {
  return S.partialPivLu().solve(Eigen::Matrix3d::Identity());
}

/// Standard uncertainties of the elements of g S^-1, to first order: dM = -M dS M / g.
Eigen::Matrix3d uncertainty_of_inverse(ExportFrame frame, const Inputs& inputs, double g) {
  const int used = frame == ExportFrame::kItem ? 6 : 9;
  Eigen::Matrix<double, 9, 9> by_input = Eigen::Matrix<double, 9, 9>::Zero();
  for (int i = 0; i < used; ++i) {
    Eigen::Matrix<double, 9, 1> up = inputs.value, down = inputs.value;
    const double step = 1e-6 * std::max(1.0, std::abs(inputs.value[i]));
    up[i] += step;
    down[i] -= step;
    const Eigen::Matrix3d difference =
        g * (inverse_of(matrix_of(frame, up)) - inverse_of(matrix_of(frame, down))) / (2.0 * step);
    for (Eigen::Index k = 0; k < 9; ++k) by_input(k, i) = difference(k / 3, k % 3);
  }
  const Eigen::Matrix<double, 9, 1> variance =
      (by_input * inputs.covariance * by_input.transpose()).diagonal();
  Eigen::Matrix3d u;
  for (Eigen::Index k = 0; k < 9; ++k) u(k / 3, k % 3) = std::sqrt(std::max(0.0, variance[k]));
  return u;
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

Eigen::Matrix3d CorrectionConstants::matrix_si() const {
  if (!unit_mps2) {
    throw std::invalid_argument(
        fmt::format("the output is in {}, this format takes accelerations; required: an output in g, mg or "
                    "m/s2, or the formats "
                    "json, csv, mat, c",
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
        "local gravity is not known, so that accelerations are not; required: a run, or a CSV with its bench "
        "file");
  }
  CorrectionConstants constants;
  constants.frame = frame;
  constants.response_unit = result.response_unit;
  constants.unit_mps2 = acceleration_unit_mps2(result.response_unit);
  constants.g_loc_mps2 = result.g_loc.value;
  const Inputs inputs = inputs_of(result, frame);
  const Eigen::Matrix3d S = matrix_of(frame, inputs.value);
  constants.M = inverse_of(S) * result.g_loc.value;
  constants.u_M = uncertainty_of_inverse(frame, inputs, result.g_loc.value);
  constants.b = result.offset_values();
  for (std::size_t j = 0; j < 3; ++j)
    constants.u_b[static_cast<Eigen::Index>(j)] = result.offset[j].standard_uncertainty;
  constants.source = fmt::format("{}, {} estimator", result.source, result.estimator);
  constants.verdict = to_string(result.verdict);
  return constants;
}

}  // namespace abcal
