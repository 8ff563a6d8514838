#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/effect_solution.h"

namespace abcal {

/// One item of a tray, with its own fit.
struct TrayMember {
  /// Its model is moved to the common solution; its fit is not changed.
  EffectSolution* own = nullptr;
  std::vector<int> angle;  ///< For each reading: index of the stage's angle.
};

/// One angle of the stage.
struct TrayAngle {
  int experiment = 0;  ///< 1, 2, 3
  double sin_alpha = 0.0, cos_alpha = 1.0;
  int face = 1;  ///< 1 or 2 (protocol/plan/faces.h).
};

/// The common fit of several items on one stage.
struct TrayFit {
  bool converged = false;
  int iterations = 0;
  /// For each member, in their order: the item's fit from all readings. Unknowns, values, their covariance,
  /// line response with shares and gain (by the item's own readings), and step errors are those of the common
  /// fit; noise, residuals and tests are those of the item's own fit.
  std::vector<EffectFit> items;
  /// Covariance of the line responses of all members, 12 for each (R).
  Eigen::MatrixXd covariance;
  /// The stage: its unknowns, their values and covariance; the step error of each angle.
  EffectFit stage;
  /// Error of the angle turned at each angle, minus the mean error over the experiment's angles: smooth and
  /// other step errors together (radian).
  std::vector<double> angle_error, u_angle_error;
  double chi2 = 0.0;  ///< For all readings, priors included.
  /// For each member: increase of chi2 by its readings over that of the others alone. If the model is right
  /// it has a chi2 distribution with the degrees of freedom of the item's own fit. For one member: chi2.
  std::vector<double> chi2_given_others;
};

/// Least squares over all readings of all members. Each item has the noise that fits all readings best, among
/// those that its own fit found probable. The unknowns of the stage and its step errors are common, and their
/// priors count once. The own unknowns of each item are eliminated first (Schur complement), so that the cost
/// grows linearly with the number of items; the common block of stage and step errors is solved last. Where
/// an item's noise is uncertain, its own block of the covariance is averaged over its probable noises
/// (docs/theory/tray.md).
/// @throws std::invalid_argument no members; members whose stage unknowns differ; shared maps of step errors
TrayFit fit_tray(std::span<const TrayMember> members, std::span<const TrayAngle> angles);

}  // namespace abcal
