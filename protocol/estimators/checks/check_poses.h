#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// What may have changed between two visits of the check poses, from there on.
enum class PoseChangeKind {
  kGain,    ///< The sensitivity of one output.
  kOffset,  ///< The offset of one output.
  kTurn,    ///< The accelerometer turned on the platter, or an axis lost its angle.
};

struct PoseChange {
  PoseChangeKind kind = PoseChangeKind::kGain;
  int accelerometer = -1;       ///< 0, 1, 2 = u, v, w; -1 for a turn.
  std::size_t after_visit = 0;  ///< In CheckPoseStudy::visits: between this one and the next.
  double size = 0.0;  ///< Gain: relative; offset: over the sensitivity; turn: radian, its magnitude.
  double standard_uncertainty = 0.0;
  double fall = 0.0;                 ///< Of chi2, with it.
  double needed = 0.0;               ///< The fall that a sound run reaches once in 1e6 runs, with any change.
  std::vector<std::string> as_well;  ///< "the offset of v": what explains the same nearly as well.
};

/// One visit of the check poses.
struct PoseVisit {
  std::size_t after = 0;  ///< So many of RunRecord::dwells were measured before it.
  double t = 0.0;         ///< Time, as run_time_fractions() has it: may be just outside -1/2 to 1/2.
};

/// What the outputs read at a check pose minus what they read at its first visit.
struct PoseDifference {
  int pose = 0;                                                    ///< 1 or 2
  std::size_t visit = 0;                                           ///< In CheckPoseStudy::visits; from 1.
  Eigen::Vector3d value = Eigen::Vector3d::Zero();                 ///< R
  Eigen::Vector3d standard_uncertainty = Eigen::Vector3d::Zero();  ///< Of the two readings alone (R).
};

/// Change from the first visit to the last, in the run as it was, and how well the poses know it.
struct PoseTrend {
  double change = 0.0;  ///< Gain: relative; offset: over the sensitivity.
  double standard_uncertainty =
      0.0;                      ///< From readings and stage; drift within its statement is no part of it.
  double smallest_found = 0.0;  ///< A step of this size between two visits would have been found.
};

struct CheckPoseStudy {
  std::vector<PoseVisit> visits;
  std::array<double, 3> sensitivity{};  ///< |s_u|, |s_v|, |s_w|, R/g_loc, as known here (1e-3).
  std::array<PoseTrend, 3> gain, offset;
  std::vector<PoseDifference> differences;
  std::vector<PoseChange> found;  ///< Beyond what a sound run shows, the most telling first.
};

/// Compares what the outputs read at the check poses at each visit. The readings of one pose are the same but
/// for their noise, the errors of the stage at each return (step), the drifts of offset and sensitivity and
/// the hysteresis within their stated sizes: all of these together are the covariance of the readings. A
/// change at one of the intervals between visits is one more unknown; the one that makes chi2 fall farthest
/// is accounted for, and the search goes on. The two poses are opposite, so that gain and offset are told
/// apart.
/// @return nothing where there are fewer than two visits, or the readings carry no uncertainty
std::optional<CheckPoseStudy> study_check_poses(const RunRecord& record);

/// The same where the readings of the experiments may not determine the outputs: then nothing.
std::optional<CheckPoseStudy> compared_check_poses(const RunRecord& record);

/// The same as checks: one for the gain and one for the offset of each output; what was found is named, sized
/// and placed, and does not pass. Empty where there is nothing to compare.
std::vector<Check> check_pose_checks(const RunRecord& record);

}  // namespace abcal
