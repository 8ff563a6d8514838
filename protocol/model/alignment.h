#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "drivers/instrument/angle.h"

namespace abcal {

/// RRF(v, e, a) = v cos a + (e x v) sin a + e (e . v) (1 - cos a): `v` turned right-handed by `a` about the
/// unit vector `e` (Rodrigues; docs/theory/model.md). Both in the same frame; the unit is that of `v`.
Eigen::Vector3d rodrigues(const Eigen::Vector3d& v, const Eigen::Vector3d& e, Angle a);

/// Directions of the stage's axes in the LGCS (z up; turned so that X has no y component).
struct Alignment {
  double zx = 0.0;  ///< Horizontal components of the Z axis at rest, 1.
  double zy = 0.0;
  double xz = 0.0;  ///< Vertical component of the X axis, 1.

  /// Z = (zx, zy, sqrt(1 - zx2 - zy2)), a unit vector.
  Eigen::Vector3d z_axis() const;
  /// X = (sqrt(1 - xz2), 0, xz), a unit vector.
  Eigen::Vector3d x_axis() const;
};

/// The sensitivity matrix in the LGCS of an accelerometer on the platter: each row of `platter_sensitivity`
/// (rows u, v, w; R/g_loc) turned by RRF(s_j, E, Theta_E), E = z x Z / |z x Z|, Theta_E the angle from z to
/// Z. This tilted matrix is determined by the measurement, and is called the truth (docs/theory/model.md).
/// With zx = zy = 0 the matrix is unchanged.
Eigen::Matrix3d tilted(const Eigen::Matrix3d& platter_sensitivity, const Alignment& alignment);

/// All angular errors of the accelerometer calibration system (ACS). Default: a perfect stage.
struct AcsErrors {
  Alignment alignment;
  Angle d2;           ///< Experiment 2 begins with Z turned by -90 degrees + d2.
  Angle d3;           ///< Experiment 3 begins with X turned by -90 degrees + d3.
  Angle mean_step_x;  ///< F_X, added to every angle of experiments 1 and 2.
  Angle mean_step_z;  ///< F_Z, added to every angle of experiment 3.
  /// f_i(n) at [i - 1][n - 1]. A list that is too short (or empty) means zero beyond its end.
  std::array<std::vector<Angle>, 3> step_errors;

  /// Error of alpha(n) in experiment 1..3: F + f_i(n). n = 1..N.
  Angle rotation_error(int experiment, int n) const;
};

}  // namespace abcal
