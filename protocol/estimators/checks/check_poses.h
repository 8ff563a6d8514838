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

/// Kind of change between two visits of the check poses. It lasts until the end of the run.
enum class PoseChangeKind {
  kGain,    ///< The sensitivity of one output.
  kOffset,  ///< The offset of one output.
  kTurn,    ///< The accelerometer turned on the platter, or an axis lost its angle.
};

struct PoseChange {
  PoseChangeKind kind = PoseChangeKind::kGain;
  int accelerometer = -1;       ///< 0, 1, 2 = u, v, w; -1 for a turn.
  std::size_t after_visit = 0;  ///< Index in CheckPoseStudy::visits: between this visit and the next.
  double size = 0.0;  ///< Gain: relative; offset: over the sensitivity; turn: radian, its magnitude.
  double standard_uncertainty = 0.0;
  double fall = 0.0;             ///< Fall of chi2 with this change.
  double needed = 0.0;           ///< The fall that one of 1e6 sound runs reaches with any change.
  std::vector<Message> as_well;  ///< Nearly as good explanations: "the offset of v".
};

/// One visit of the check poses.
struct PoseVisit {
  std::size_t after = 0;  ///< Number of RunRecord::dwells measured before it.
  double t = 0.0;         ///< Time on the scale of run_time_fractions(); may be just outside -1/2 to 1/2.
};

/// Readings at a check pose minus the readings at its first visit.
struct PoseDifference {
  int pose = 0;                                     ///< 1 or 2
  std::size_t visit = 0;                            ///< Index in CheckPoseStudy::visits; from 1.
  Eigen::Vector3d value = Eigen::Vector3d::Zero();  ///< R
  Eigen::Vector3d standard_uncertainty = Eigen::Vector3d::Zero();  ///< From the noise of both readings (R).
};

/// Change of an output from the first visit to the last, and how well the check poses determine it.
struct PoseTrend {
  double change = 0.0;                ///< Gain: relative; offset: over the sensitivity.
  double standard_uncertainty = 0.0;  ///< From readings and stage, without the stated drift.
  double smallest_found = 0.0;        ///< A step of this size between two visits would have been found.
};

struct CheckPoseStudy {
  std::vector<PoseVisit> visits;
  std::array<double, 3> sensitivity{};  ///< |s_u|, |s_v|, |s_w|, R/g_loc, to 1e-3 only.
  std::array<PoseTrend, 3> gain, offset;
  std::vector<PoseDifference> differences;
  std::vector<PoseChange> found;  ///< Changes beyond those of a sound run, most significant first.
};

/// Compares the readings at the check poses between visits. The readings of one pose differ only by their
/// noise, the errors of the stage at each return (step), the drifts of offset and sensitivity and the
/// hysteresis within their stated sizes: all of these together are the covariance of the readings. A change
/// in one of the intervals between visits is one more unknown; the one with the largest decrease of chi2 is
/// accounted for, and the search continues. The two poses are opposite, so that gain and offset can be
/// separated.
/// @return nullopt if there are fewer than two visits, or if the readings have no uncertainty
std::optional<CheckPoseStudy> study_check_poses(const RunRecord& record);

/// As study_check_poses(), but returns nothing instead of throwing UnusableData.
std::optional<CheckPoseStudy> compared_check_poses(const RunRecord& record);

/// The study as checks: one for the gain and one for the offset of each output. A change fails its check,
/// which names it with size and place. Empty for a record without check poses.
std::vector<Check> check_pose_checks(const RunRecord& record);

/// "experiment 2, alpha = 35 degrees".
Message dwell_words(const DwellRecord& dwell);

}  // namespace abcal
