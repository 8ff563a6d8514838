#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/effect_solution.h"

namespace abcal {

/// One item of a tray, as its own fit left it.
struct TrayMember {
  /// Its model is moved to the common solution; its fit stays as it is.
  EffectSolution* own = nullptr;
  std::vector<int> angle;  ///< Of each reading: which angle of the stage it was taken at.
};

/// One angle of the stage.
struct TrayAngle {
  int experiment = 0;  ///< 1, 2, 3
  double sin_alpha = 0.0, cos_alpha = 1.0;
};

/// The common fit of several items that one stage turns.
struct TrayFit {
  bool converged = false;
  int iterations = 0;
  /// Of each member, in their order: what is known of the item from all readings. Unknowns, values, their
  /// covariance, line response with shares and gain (by the item's own readings), and step errors are those
  /// of the common fit; noise, residuals and tests are those of the item's own.
  std::vector<EffectFit> items;
  /// Between the line responses of all members, 12 of each (R).
  Eigen::MatrixXd covariance;
  /// The stage: its unknowns, their values and covariance; step errors, of each angle.
  EffectFit stage;
  /// By how much more the stage turned at each angle than on the average of the experiment's angles, beyond
  /// what was commanded: smooth and other step errors together (radian).
  std::vector<double> angle_error, u_angle_error;
  double chi2 = 0.0;  ///< Of all readings, priors included.
  /// Of each member: by how much its readings raise chi2 above that of the others alone. If the model is
  /// right it is chi2 with as many degrees of freedom as the item's own fit. For one member alone it is chi2.
  std::vector<double> chi2_given_others;
};

/// Least squares over all readings of all members. Of the noises that the item's own fit found probable each
/// item has the one that suits all readings best. The
/// unknowns of the stage and its step errors are common, and their priors count once. Of each item its own
/// unknowns are eliminated first (Schur complement), so that the cost grows with the number of items; the
/// common block of stage and step errors is solved last. Where an item's noise is uncertain, its own block of
/// the covariance is averaged over its probable noises (docs/theory/tray.md).
/// @throws std::invalid_argument no members; members whose stage unknowns differ; shared maps of step errors
TrayFit fit_tray(std::span<const TrayMember> members, std::span<const TrayAngle> angles);

}  // namespace abcal
