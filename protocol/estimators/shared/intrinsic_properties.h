#pragma once

#include <Eigen/Core>

#include "drivers/instrument/angle.h"

namespace abcal {

/// Properties that do not depend on the mounting of the accelerometer (paper, Eqs. 9-10).
struct IntrinsicProperties {
  Eigen::Vector3d sensitivity = Eigen::Vector3d::Zero();  ///< |s_u|, |s_v|, |s_w| (R/g_loc).
  Eigen::Vector3d angle_deg = Eigen::Vector3d::Zero();    ///< phi_uv, phi_vw, phi_wu (degree), 0..180.
};

/// The angle between two vectors, by atan2(|a x b|, a . b): full precision at every angle.
Angle angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b);

/// @param sensitivity_matrix rows u, v, w (R/g_loc), in any orthonormal frame
IntrinsicProperties intrinsic_properties(const Eigen::Matrix3d& sensitivity_matrix);

/// Derivatives of (s_u, s_v, s_w, phi_uv, phi_vw, phi_wu, O_u, O_v, O_w) with respect to the twelve outputs
/// (s row by row, O). Angles in degrees. An angle of 0 or 180 degrees, or a row of zeros, has no derivative:
/// NaN.
Eigen::Matrix<double, 9, 12> intrinsic_jacobian(const Eigen::Matrix3d& sensitivity_matrix);

}  // namespace abcal
