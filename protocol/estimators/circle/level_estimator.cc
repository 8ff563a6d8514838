#include "protocol/estimators/circle/level_estimator.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "protocol/linear/pivoted_qr.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

/// How near a commanded angle must be to its position to count as that: far above any setting error, far
/// below the spacing of positions.
constexpr double kPositionWindowDeg = 0.5;
/// Reciprocal condition below which angles hide the harmonic.
constexpr double kSingular = 1e-8;

/// Angle to the nearest multiple of 360 degrees.
double from_full_turn(Angle angle) {
  return std::remainder(angle.deg(), 360.0);
}

void check(const DwellRecord& dwell, const char* what) {
  if (!dwell.mean.allFinite() || !std::isfinite(dwell.commanded_x.deg()) ||
      !std::isfinite(dwell.commanded_z.deg())) {
    throw std::invalid_argument(std::string(what) + ": a reading or angle is not a finite number");
  }
  if (dwell.u_mean && (!dwell.u_mean->allFinite() || dwell.u_mean->minCoeff() < 0.0)) {
    throw std::invalid_argument(std::string(what) + ": an uncertainty is not a finite number >= 0");
  }
}

void check(const Eigen::Matrix3d& sensitivity_matrix, const char* what) {
  if (!sensitivity_matrix.allFinite()) {
    throw std::invalid_argument(std::string(what) + ": the sensitivity matrix is not finite");
  }
}

bool all_uncertain(std::span<const DwellRecord> dwells) {
  return std::all_of(dwells.begin(), dwells.end(),
                     [](const DwellRecord& dwell) { return dwell.u_mean && dwell.u_mean->minCoeff() > 0.0; });
}

Quantity with_type_a(double value, double u, std::string unit) {
  Quantity out;
  out.value = value;
  out.standard_uncertainty = u;
  out.type_a = u;
  out.unit = std::move(unit);
  return out;
}

constexpr const char* kTiltOfZ = "tilt of Z";

/// The linear equations of the tilt. Unknowns: Zx, Zy, three constants, three drifts where every dwell has
/// its time. To first order in the tilt, gravity seen from the platter is (Zx, Zy, 1) + cos(theta) (-Zx, -Zy,
/// 0)
/// + sin(theta) (-Zy, Zx, 0); (Zx, Zy, 1) stays and joins the constant.
struct SpinEquations {
  Eigen::MatrixXd design;
  Eigen::VectorXd right;
  bool weighted = false;
};

SpinEquations spin_equations(std::span<const DwellRecord> dwells, const Eigen::Matrix3d& sensitivity_matrix) {
  double first = 0.0;
  double last = 0.0;
  bool timed = !dwells.empty();
  for (std::size_t i = 0; i < dwells.size(); ++i) {
    const DwellRecord& dwell = dwells[i];
    check(dwell, kTiltOfZ);
    if (std::abs(from_full_turn(dwell.commanded_x)) > kPositionWindowDeg) {
      throw std::invalid_argument(
          fmt::format("{}: X stands at {} degrees; 0 is required", kTiltOfZ, dwell.commanded_x.deg()));
    }
    timed = timed && dwell.time_s && std::isfinite(*dwell.time_s);
    if (!timed) continue;
    first = i == 0 ? *dwell.time_s : std::min(first, *dwell.time_s);
    last = i == 0 ? *dwell.time_s : std::max(last, *dwell.time_s);
  }
  timed = timed && last > first && dwells.size() >= 4;

  const int unknowns = timed ? 8 : 5;
  const auto rows = static_cast<Eigen::Index>(3 * dwells.size());
  if (rows < unknowns) {
    throw std::runtime_error(fmt::format("{}: {} angles; more are required", kTiltOfZ, dwells.size()));
  }
  SpinEquations out{Eigen::MatrixXd::Zero(rows, unknowns), Eigen::VectorXd(rows), all_uncertain(dwells)};
  for (std::size_t i = 0; i < dwells.size(); ++i) {
    const DwellRecord& dwell = dwells[i];
    const SinCos theta = sincos(dwell.commanded_z);
    for (Eigen::Index j = 0; j < 3; ++j) {
      const Eigen::Index row = 3 * static_cast<Eigen::Index>(i) + j;
      const double w = out.weighted ? 1.0 / (*dwell.u_mean)(j) : 1.0;
      const double sx = sensitivity_matrix(j, 0);
      const double sy = sensitivity_matrix(j, 1);
      out.design(row, 0) = w * (-sx * theta.cos + sy * theta.sin);
      out.design(row, 1) = w * (-sy * theta.cos - sx * theta.sin);
      out.design(row, 2 + j) = w;
      if (timed) out.design(row, 5 + j) = w * ((*dwell.time_s - first) / (last - first) - 0.5);
      out.right(row) = w * dwell.mean(j);
    }
  }
  return out;
}

}  // namespace

TiltOfZ tilt_from_spin(std::span<const DwellRecord> dwells, const Eigen::Matrix3d& sensitivity_matrix) {
  check(sensitivity_matrix, kTiltOfZ);
  const SpinEquations equations = spin_equations(dwells, sensitivity_matrix);
  const Eigen::Index unknowns = equations.design.cols();
  const bool weighted = equations.weighted;
  const Eigen::VectorXd scale = equations.design.colwise().norm();
  if (!(scale.minCoeff() > 0.0)) {
    throw std::runtime_error(std::string(kTiltOfZ) +
                             ": the sensitivity matrix or the angles hide the harmonic");
  }
  const Eigen::MatrixXd scaled = scaled_columns(equations.design, scale.cwiseInverse());
  const PivotedQr qr(scaled);
  if (!(qr.reciprocal_condition() > kSingular)) {
    throw std::runtime_error(
        fmt::format("{}: {} angles about Z hide the harmonic; angles around the circle are required",
                    kTiltOfZ, dwells.size()));
  }
  const Eigen::VectorXd solution = qr.solve_vector(equations.right);
  const double squares = (equations.right - product_with_vector(scaled, solution)).squaredNorm();

  TiltOfZ out;
  out.degrees_of_freedom = static_cast<int>(equations.right.size() - unknowns);
  if (weighted) out.chi2 = squares;
  double factor = weighted ? 1.0 : std::numeric_limits<double>::quiet_NaN();
  if (out.degrees_of_freedom > 0) {
    const double found = squares / out.degrees_of_freedom;
    factor = weighted ? std::max(1.0, found) : found;
  }
  Eigen::Matrix2d covariance = factor * covariance_of_root(qr.cofactor_root().topRows(2));
  const Eigen::Vector2d units = scale.head(2).cwiseInverse();
  covariance = units.asDiagonal() * covariance * units.asDiagonal();
  const Eigen::Vector2d tilt = units.cwiseProduct(solution.head(2));
  out.zx = with_type_a(tilt(0), std::sqrt(covariance(0, 0)), "1");
  out.zy = with_type_a(tilt(1), std::sqrt(covariance(1, 1)), "1");
  out.covariance_zx_zy = covariance(0, 1);
  const double delta = tilt.norm();
  // Along the tilt; a tilt of zero has no direction, then the larger of the two.
  const double variance =
      delta > 0.0 ? tilt.dot(covariance * tilt) / (delta * delta) : covariance.diagonal().maxCoeff();
  out.delta_z = with_type_a(delta, std::sqrt(variance), "1");
  return out;
}

XZero x_zero_from_reversal(std::span<const DwellRecord> dwells, const Eigen::Matrix3d& sensitivity_matrix,
                           const Tolerances& tolerances) {
  constexpr const char* kWhat = "zero of X";
  check(sensitivity_matrix, kWhat);
  if (!(tolerances.step.deg() >= 0.0))
    throw std::invalid_argument(std::string(kWhat) + ": negative step tolerance");
  // Mean of each position, [X at 180][Z at 180].
  std::array<std::array<Eigen::Vector3d, 2>, 2> mean{};
  std::array<std::array<Eigen::Vector3d, 2>, 2> variance{};
  std::array<std::array<int, 2>, 2> count{};
  for (auto& row : mean) row.fill(Eigen::Vector3d::Zero());
  for (auto& row : variance) row.fill(Eigen::Vector3d::Zero());
  const auto half_turn = [](Angle angle) -> std::optional<std::size_t> {
    if (std::abs(from_full_turn(angle)) <= kPositionWindowDeg) return 0;
    if (std::abs(from_full_turn(angle - Angle::degrees(180.0))) <= kPositionWindowDeg) return 1;
    return std::nullopt;
  };
  const bool weighted = all_uncertain(dwells);
  for (const DwellRecord& dwell : dwells) {
    check(dwell, kWhat);
    const auto x = half_turn(dwell.commanded_x);
    const auto z = half_turn(dwell.commanded_z);
    if (!x || !z) {
      throw std::invalid_argument(
          fmt::format("{}: position X = {}, Z = {} degrees; 0 or 180 each are required", kWhat,
                      dwell.commanded_x.deg(), dwell.commanded_z.deg()));
    }
    mean[*x][*z] += dwell.mean;
    if (weighted) variance[*x][*z] += dwell.u_mean->cwiseAbs2();
    ++count[*x][*z];
  }
  for (std::size_t x = 0; x < 2; ++x) {
    for (std::size_t z = 0; z < 2; ++z) {
      if (count[x][z] == 0) {
        throw std::invalid_argument(
            fmt::format("{}: position X = {}, Z = {} degrees is missing", kWhat, 180 * x, 180 * z));
      }
      mean[x][z] /= count[x][z];
      variance[x][z] /= static_cast<double>(count[x][z]) * count[x][z];
    }
  }
  // Each combination is s_jy error - s_jx (Zx + Xz), to first order.
  const Eigen::Vector3d difference = 0.25 * (mean[0][0] - mean[0][1] - mean[1][0] + mean[1][1]);
  Eigen::Vector3d u2 = 0.0625 * (variance[0][0] + variance[0][1] + variance[1][0] + variance[1][1]);
  const Eigen::Vector3d weight =
      weighted ? Eigen::Vector3d(u2.cwiseInverse().cwiseSqrt()) : Eigen::Vector3d::Ones();
  Eigen::Matrix<double, 3, 2> design;
  design.col(0) = weight.cwiseProduct(sensitivity_matrix.col(1));
  design.col(1) = -weight.cwiseProduct(sensitivity_matrix.col(0));
  const PivotedQr qr(design);
  if (!(qr.reciprocal_condition() > kSingular)) {
    throw std::invalid_argument(std::string(kWhat) + ": the sensitivity matrix does not tell x from y");
  }
  const Eigen::Vector3d right = weight.cwiseProduct(difference);
  const Eigen::Vector2d solution = qr.solve_vector(right);
  const double squares = (right - design * solution).squaredNorm();
  // With one degree of freedom the estimate of the noise is poor, but without u_mean there is no other.
  const double factor = weighted ? std::max(1.0, squares) : squares;
  const Eigen::Matrix2d covariance = factor * covariance_of_root(qr.cofactor_root());

  XZero out;
  const Angle error = Angle::radians(solution(0));
  out.error.value = error.deg();
  out.error.type_a = Angle::radians(std::sqrt(covariance(0, 0))).deg();
  // The combination sees half of the step error at X = 180 degrees.
  out.error.type_b = 0.5 * tolerances.step.deg();
  out.error.standard_uncertainty = std::hypot(*out.error.type_a, *out.error.type_b);
  out.error.unit = "degree";
  out.zx_plus_xz = with_type_a(solution(1), std::sqrt(covariance(1, 1)), "1");
  return out;
}

}  // namespace abcal
