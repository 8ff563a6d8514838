#pragma once

#include <Eigen/Core>

#include "drivers/instrument/angle.h"
#include "protocol/model/alignment.h"

namespace abcal {

/// Specific force at rest, seen from the accelerometer, in one experiment: constant + circle,
///   g(a) = centre + cosine cos(a) + sine sin(a),   in units of g_loc, |g| = 1,
/// `a` the actual rotation angle (alpha + F + f). Components along x, y, z of the LGCS as they were fixed to
/// the accelerometer at the default orientation, so that the response is s g + O. Physics.md section 2,
/// "Speed".
struct GravityCircle {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d cosine = Eigen::Vector3d::Zero();
  Eigen::Vector3d sine = Eigen::Vector3d::Zero();

  Eigen::Vector3d at(Angle actual) const;
};

/// The circle of experiment 1, 2 or 3: about X; about X with Z first turned -90 degrees + d2; about Z with X
/// first turned -90 degrees + d3. Step errors of `errors` play no part: they belong to the angle.
/// @throws std::invalid_argument for another experiment.
GravityCircle gravity_circle(int experiment, const AcsErrors& errors);

/// Specific force (g_loc) seen from the accelerometer at the desired angle `alpha` = alpha(n) of an
/// experiment, with all errors: mean step error and f_i(n) are added to alpha. n = 1..N picks f_i(n).
Eigen::Vector3d gravity_in_aut(int experiment, int n, Angle alpha, const AcsErrors& errors);

/// A triaxial accelerometer as the estimators model it. Element j of every vector belongs to accelerometer j
/// = u, v, w.
struct AccelerometerModel {
  Eigen::Matrix3d sensitivity_matrix =
      Eigen::Matrix3d::Identity();                   ///< R/g_loc, rows u v w, in the LGCS (tilted).
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< R
  Eigen::Vector3d k2 = Eigen::Vector3d::Zero();      ///< 1/R
  Eigen::Vector3d k3 = Eigen::Vector3d::Zero();      ///< 1/R^2
  Eigen::Vector3d drift = Eigen::Vector3d::Zero();   ///< R over the whole run
};

/// Response (R) to the specific force `gravity` (g_loc) at time t, from -1/2 to 1/2 over the run:
/// l + k2 (l - O)^2 + k3 (l - O)^3 + b t,  l = s . g + O  (docs/theory/joint_estimator.md).
Eigen::Vector3d response(const AccelerometerModel& accelerometer, const Eigen::Vector3d& gravity,
                         double t = 0.0);

}  // namespace abcal
