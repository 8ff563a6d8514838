#pragma once

#include <optional>
#include <string>
#include <vector>

#include "protocol/analysis/calibration_result.h"
#include "protocol/analysis/effect_solution.h"
#include "protocol/analysis/joint_data.h"
#include "protocol/analysis/joint_fit.h"
#include "protocol/analysis/joint_verdict.h"

namespace abcal {

/// The joint fit of one record, with what a common fit of several items goes on from. The dwells in `data`
/// live in the record. It may be moved, not copied: the solution reads the readings where they lie.
struct JointWork {
  JointData data;
  std::vector<EffectReading> readings;
  EffectFitOptions options;
  std::optional<EffectSolution> solution;  ///< Absent: `why` says why.
  std::string why;
  JointTests tests;
  std::vector<std::string> hidden;  ///< What the noise process hides of the stage, in words.

  JointWork() = default;
  JointWork(JointWork&&) = default;
  JointWork& operator=(JointWork&&) = default;
  JointWork(const JointWork&) = delete;
  JointWork& operator=(const JointWork&) = delete;
  ~JointWork() = default;
};

JointWork fit_jointly(const RunRecord& record, const JointOptions& options);

/// The result of the work. @param fit  that of the solution, or one of the same unknowns that knows more;
/// not read where there is no solution
CalibrationResult joint_result(const RunRecord& record, const JointWork& work, const EffectFit& fit);
/// With the fit of the solution.
CalibrationResult joint_result(const RunRecord& record, const JointWork& work);

}  // namespace abcal
