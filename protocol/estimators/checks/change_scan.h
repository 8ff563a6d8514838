#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/run_record.h"

namespace abcal {

/// Kind of change at one angle of a run. The first five are lasting: they affect all later angles, too.
enum class ChangeKind {
  kSlip,      ///< The accelerometer turned on the platter.
  kAxisX,     ///< Axis X lost its angle: a missed step that the encoder does not see.
  kAxisZ,     ///< Axis Z lost its angle, or the accelerometer slipped about z: indistinguishable.
  kOutput,    ///< One output jumped.
  kGain,      ///< The sensitivity of one output changed.
  kAngle,     ///< The stage was at another angle for one dwell.
  kReading,   ///< One output was wrong for one dwell.
  kReadings,  ///< All three were wrong for one dwell, which no other angle explains.
};
inline constexpr std::array kChangeKinds{ChangeKind::kSlip,    ChangeKind::kAxisX,   ChangeKind::kAxisZ,
                                         ChangeKind::kOutput,  ChangeKind::kGain,    ChangeKind::kAngle,
                                         ChangeKind::kReading, ChangeKind::kReadings};

struct Change {
  ChangeKind kind = ChangeKind::kSlip;
  std::size_t at = 0;      ///< Index in ChangeScan::dwells of the first, or the only, angle affected.
  int accelerometer = -1;  ///< kOutput, kGain, kReading: 0, 1, 2 = u, v, w.
  /// kSlip: rotation vector along the platter's x, y, z at the default orientation, radian. kAxisX, kAxisZ,
  /// kAngle: radian, in element 0. kGain: relative. Others: R; kReadings all three, else in element 0.
  Eigen::Vector3d size = Eigen::Vector3d::Zero();
  double gain = 0.0;    ///< Fall of chi2 with this change, over the remaining reduced chi2 (1 or more).
  double needed = 0.0;  ///< The gain that a sound run reaches once in 1e6 runs, at any of its angles.
  bool beyond = false;  ///< Gain and size both exceed their limits: noise and tolerances do not explain it.
  /// Kinds that explain the same readings nearly as well.
  std::vector<ChangeKind> as_well;

  /// |size|, in degrees for the turns and relative to the sensitivity for the outputs.
  double magnitude = 0.0;
  double limit = 0.0;  ///< Limit of the magnitude: the bench's, or the least detectable here if larger.
};

struct ChangeScan {
  bool converged = false;  ///< False: the readings do not fit the model of the experiments at all.
  std::vector<const DwellRecord*> dwells;  ///< In the order of time; owned by the record.
  std::vector<Change> found;               ///< Changes beyond their limits, most significant first.
  /// A turn was too large for the linear model: the search ended with it, and the members below are
  /// incomplete.
  bool too_large = false;
  // With the changes found accounted for:
  std::vector<Change> largest;  ///< The most significant remaining change of each kind.
  /// |s_u|, |s_v|, |s_w|, R/g_loc, and their standard uncertainties.
  Eigen::Vector3d sensitivity = Eigen::Vector3d::Zero(), u_sensitivity = Eigen::Vector3d::Zero();
  /// Drifts over the run, R, and their standard uncertainties with the prior of [tolerances] drift.
  Eigen::Vector3d drift = Eigen::Vector3d::Zero(), u_drift = Eigen::Vector3d::Zero();
};

/// Searches for deviations from the joint model (stage errors within the tolerances, noise, drift and
/// non-linearity), and for the single change at one angle that explains them best: for every kind and angle
/// the fall of chi2 when the change is one more unknown (a generalised likelihood ratio; all of them are
/// linear, so none needs a fit of its own). The best is accounted for, and the search continues without it;
/// angles found to be wrong for one dwell are then left out of the fit, and the search is repeated.
///
/// A change is reported if chi2, in units of the remaining scatter, falls farther than in one of 1e6 sound
/// runs, and if its size exceeds the limit of its kind (protocol/plan/limits.h). A smooth error of the stage
/// (harmonics 1 to 3 of an experiment, each within the step tolerance) is not taken for a change.
/// @throws UnusableData for fewer than 5 angles, and for readings that the joint fit cannot use
ChangeScan scan_for_changes(const RunRecord& record);

}  // namespace abcal
