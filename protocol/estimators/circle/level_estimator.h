#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/tolerances.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The tilt of the Z axis, from a spin about Z at Theta_X = 0 (paper, Appendix A).
struct TiltOfZ {
  Quantity zx, zy;   ///< 1
  Quantity delta_z;  ///< sqrt(Zx2 + Zy2), 1
  double covariance_zx_zy = 0.0;
  std::optional<double> chi2;  ///< Absent where the readings carry no uncertainty.
  int degrees_of_freedom = 0;
};

/// Readings r_j = s_j . RRF(z, Z, -theta_Z) + O_j: gravity seen from the platter turns about Z with amplitude
/// Delta_Z. One harmonic with a common (Zx, Zy) and a constant for each accelerometer, and a linear drift
/// where every dwell has its time. theta_Z is `commanded_z`. Uncertainties: from u_mean where every dwell has
/// it (widened by the residuals where chi2/dof exceeds 1), else from the residuals. Step errors of Z act in
/// second order only (tilt times error), so there is no type B.
/// @param sensitivity_matrix  R/g_loc; a plain ABC result does (a relative error of it is one of the tilt)
/// @throws std::invalid_argument a dwell with commanded_x other than 0, a number that is not finite
/// @throws std::runtime_error too few angles, or angles that hide the harmonic
TiltOfZ tilt_from_spin(std::span<const DwellRecord> dwells, const Eigen::Matrix3d& sensitivity_matrix);

/// The zero of the X axis from four positions.
struct XZero {
  /// Actual minus commanded angle at X = 0 (mean of those at 0 and 180 degrees), degree. As an alignment this
  /// is Zy = -error: at X = 0 the Z axis leans by it.
  Quantity error;
  Quantity zx_plus_xz;  ///< 1; a by-product of the same readings.
};

/// Readings at (X, Z) = (0, 0), (0, 180), (180, 0), (180, 180) degrees: r(0,0) - r(0,180) - r(180,0) +
/// r(180,180) frees the zero of X from offset, sensitivity along z and, measured in that order, linear drift.
/// Each position may be measured more than once. Type B: half a step error at X = 180 degrees (tolerance
/// `step`).
/// @throws std::invalid_argument a position other than these four, one that is missing, a number not finite
XZero x_zero_from_reversal(std::span<const DwellRecord> dwells, const Eigen::Matrix3d& sensitivity_matrix,
                           const Tolerances& tolerances);

}  // namespace abcal
