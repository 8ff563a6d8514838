#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "protocol/analysis/effect_fit.h"
#include "protocol/analysis/effect_solution.h"

namespace abcal {

/// One item of a tray, as its own fit left it.
struct TrayMember {
  /// Its model is moved to the common solution; its fit stays as it is.
  EffectSolution* own = nullptr;
  std::vector<int> angle;  ///< Of each reading: which angle of the stage it was taken at.
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
  double chi2 = 0.0;  ///< Of all readings, priors included.
  /// Of each member: by how much its readings raise chi2 above that of the others alone. If the model is
  /// right it is chi2 with as many degrees of freedom as the item's own fit. Empty for one member.
  std::vector<double> chi2_given_others;
};

/// Least squares over all readings of all members, with each noise as the item's own fit found it. The
/// unknowns of the stage and its step errors are common, and their priors count once. Of each item its own
/// unknowns are eliminated first (Schur complement), so that the cost grows with the number of items; the
/// common block of stage and step errors is solved last. Where an item's noise is uncertain, its own block of
/// the covariance is averaged over its probable noises (docs/theory/tray.md).
/// @param experiments  of each angle of the stage: 1, 2, 3
/// @throws std::invalid_argument no members; members whose stage unknowns differ; shared maps of step errors
TrayFit fit_tray(std::span<const TrayMember> members, std::span<const int> experiments);

}  // namespace abcal
