#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/run_record.h"

namespace abcal {

/// What may have happened to a run at one of its angles. The first five last from there on.
enum class ChangeKind {
  kSlip,      ///< The accelerometer turned on the platter.
  kAxisX,     ///< Axis X lost its angle: a missed step that the encoder does not see.
  kAxisZ,     ///< Axis Z did, or the accelerometer slipped about z: the two are one.
  kOutput,    ///< One output jumped.
  kGain,      ///< The sensitivity of one output changed.
  kAngle,     ///< The stage stood at another angle, this once.
  kReading,   ///< One output was wrong, this once.
  kReadings,  ///< All three were wrong, this once, and not as another angle would make them.
};
inline constexpr std::array kChangeKinds{ChangeKind::kSlip,    ChangeKind::kAxisX,   ChangeKind::kAxisZ,
                                         ChangeKind::kOutput,  ChangeKind::kGain,    ChangeKind::kAngle,
                                         ChangeKind::kReading, ChangeKind::kReadings};

struct Change {
  ChangeKind kind = ChangeKind::kSlip;
  std::size_t at = 0;      ///< In ChangeScan::dwells: the first angle, or the only one, that it touches.
  int accelerometer = -1;  ///< kOutput, kGain, kReading: 0, 1, 2 = u, v, w.
  /// kSlip: rotation vector along the platter's x, y, z at the default orientation, radian. kAxisX, kAxisZ,
  /// kAngle: radian, in element 0. kGain: relative. Others: R; kReadings all three, else in element 0.
  Eigen::Vector3d size = Eigen::Vector3d::Zero();
  double gain = 0.0;    ///< By how much chi2 falls with it, over the scatter that is left.
  double needed = 0.0;  ///< The gain that a sound run reaches once in 1e6 runs, at any of its angles.
  bool beyond = false;  ///< Found beyond its limit in size, too: not explained by tolerances and noise.
  /// Kinds that explain the same nearly as well.
  std::vector<ChangeKind> as_well;

  /// |size|, in degrees for the turns and relative to the sensitivity for the outputs.
  double magnitude = 0.0;
  double limit = 0.0;  ///< Of the magnitude: the bench's, or the least that would have been found here.
};

struct ChangeScan {
  bool converged = false;                  ///< If not, the readings are not those of the experiments at all.
  std::vector<const DwellRecord*> dwells;  ///< In the order of time; they live in the record.
  std::vector<Change> found;               ///< Beyond their limits, the most telling first.
  /// The first one found is too large for a linear model: the search ended with it, and the rest is not
  /// filled.
  bool too_large = false;
  // When those found are accounted for:
  std::vector<Change> largest;  ///< Of every kind.
  /// |s_u|, |s_v|, |s_w|, R/g_loc, and their standard uncertainties.
  Eigen::Vector3d sensitivity = Eigen::Vector3d::Zero(), u_sensitivity = Eigen::Vector3d::Zero();
  /// Over the run, R, and their standard uncertainties with the prior of [tolerances] drift.
  Eigen::Vector3d drift = Eigen::Vector3d::Zero(), u_drift = Eigen::Vector3d::Zero();
};

/// Looks for what the joint model (stage errors within the tolerances, noise, drift and non-linearity) does
/// not explain, and tells which single change at which angle explains it best: for every kind and every angle
/// the fall of chi2 when the change is one more unknown (a generalised likelihood ratio; all of them are
/// linear, so none needs a fit of its own). The best is accounted for, and the search goes on without it;
/// angles found to be wrong by themselves are then left out of the fit, and all is looked at once more.
///
/// Found is what makes chi2 fall farther than a sound run does once in 1e6 runs, counted in units of the
/// scatter that is left, and is larger than the limit of its kind (protocol/plan/limits.h). A smooth error of
/// the stage (harmonics 1 to 3 of an experiment, each within the step tolerance) is not taken for a change.
/// @throws UnusableData for fewer than 5 angles, and for what a joint fit cannot take
ChangeScan scan_for_changes(const RunRecord& record);

}  // namespace abcal
