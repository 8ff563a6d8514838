#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace abcal::sim {

/// How the instrument on the platter is turned and turns: for its gyroscope, magnetometer and attitude. Its
/// body B is the right-handed frame that is closest to the directions of u, v, w.
struct BodyMotion {
  Eigen::Matrix3d R_LB;  ///< Body to LGCS.
  Eigen::Vector3d rate_B_radps;
  Eigen::Vector3d field_B_gauss;  ///< Field of the earth.

  /// Body to north, east, down; x of the LGCS points north.
  Eigen::Matrix3d to_ned() const { return Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal() * R_LB; }
  /// Body to north, west, up.
  const Eigen::Matrix3d& to_nwu() const { return R_LB; }
  /// Body to east, north, up.
  Eigen::Matrix3d to_enu() const {
    Eigen::Matrix3d R_EL;
    R_EL << 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0;
    return R_EL * R_LB;
  }
};

/// w, x, y, z with w >= 0.
inline Eigen::Quaterniond quaternion_of(const Eigen::Matrix3d& rotation) {
  Eigen::Quaterniond q(rotation);
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  return q;
}

/// Roll, pitch, yaw in rad: rotation = Rot(z, yaw) Rot(y, pitch) Rot(x, roll).
inline Eigen::Vector3d roll_pitch_yaw_of(const Eigen::Matrix3d& rotation) {
  // Adding 0 makes -0 a 0, so that half a turn is +180 degrees.
  return {std::atan2(rotation(2, 1) + 0.0, rotation(2, 2)), std::asin(std::clamp(-rotation(2, 0), -1.0, 1.0)),
          std::atan2(rotation(1, 0) + 0.0, rotation(0, 0))};
}

}  // namespace abcal::sim
