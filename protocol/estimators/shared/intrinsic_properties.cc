#include "protocol/estimators/shared/intrinsic_properties.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace abcal {

namespace {

// uv, vw, wu
constexpr std::array<std::array<Eigen::Index, 2>, 3> kPairs{{{0, 1}, {1, 2}, {2, 0}}};

}  // namespace

Angle angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b)));
}

IntrinsicProperties intrinsic_properties(const Eigen::Matrix3d& sensitivity_matrix) {
  IntrinsicProperties properties;
  properties.sensitivity = sensitivity_matrix.rowwise().norm();
  for (std::size_t i = 0; i < kPairs.size(); ++i) {
    properties.angle_deg(static_cast<Eigen::Index>(i)) =
        angle_between(sensitivity_matrix.row(kPairs[i][0]).transpose(),
                      sensitivity_matrix.row(kPairs[i][1]).transpose())
            .deg();
  }
  return properties;
}

Eigen::Matrix<double, 9, 12> intrinsic_jacobian(const Eigen::Matrix3d& sensitivity_matrix) {
  Eigen::Matrix<double, 9, 12> jacobian = Eigen::Matrix<double, 9, 12>::Zero();
  const Eigen::Vector3d norms = sensitivity_matrix.rowwise().norm();
  Eigen::Matrix3d unit = sensitivity_matrix;
  for (Eigen::Index j = 0; j < 3; ++j) {
    unit.row(j) /= norms(j);
    jacobian.block<1, 3>(j, 3 * j) = unit.row(j);
    jacobian(6 + j, 9 + j) = 1.0;
  }
  constexpr double kDegreesPerRadian = 180.0 / std::numbers::pi;
  for (std::size_t i = 0; i < kPairs.size(); ++i) {
    const Eigen::Index a = kPairs[i][0];
    const Eigen::Index b = kPairs[i][1];
    const Eigen::RowVector3d e_a = unit.row(a);
    const Eigen::RowVector3d e_b = unit.row(b);
    const double cos_phi = e_a.dot(e_b);
    const double sin_phi = e_a.cross(e_b).norm();
    const auto row = 3 + static_cast<Eigen::Index>(i);
    // d phi / d s_a = -(e_b - e_a cos phi) / (|s_a| sin phi): away from the other axis opens the angle.
    const double scale =
        sin_phi > 0.0 ? kDegreesPerRadian / sin_phi : std::numeric_limits<double>::quiet_NaN();
    jacobian.block<1, 3>(row, 3 * a) = (e_a * cos_phi - e_b) * (scale / norms(a));
    jacobian.block<1, 3>(row, 3 * b) = (e_b * cos_phi - e_a) * (scale / norms(b));
  }
  return jacobian;
}

}  // namespace abcal
