#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/measurement/measurement_fit.h"

namespace abcal {

/// Findings of a learning.
struct StageLearned {
  /// State, sizes, repeatabilities and growth; the caller adds identity and learnings.
  StageRecord record;
  MeasurementFit fit;
  /// The state against what was known before: a test for each part. Empty at the first learning.
  std::vector<EffectTest> changes;
};

/// A record from the runs of one series; with `before` a later one, in which the state of the earlier record
/// is the prior, less well known by its growth.
/// @param months  from the last learning of `before` to these runs
/// @throws as fit_measurement()
StageLearned learn_stage(std::span<const MeasuredItem> runs, const std::optional<StageRecord>& before,
                         double months);

/// The test of a record by one run: for each part of the stage how its errors in this run differ from what
/// the record predicts, against the covariance of that difference. A common turn of the whole stage about X
/// is not tested: no run shows it.
/// @param before  the record's state at the time of the run
std::vector<EffectTest> test_state(const RunInformation& run, const InRunFit& found, const StageState& before,
                                   const Repeatabilities& repeatabilities);

/// Probability that any test of a sound run contradicts its record.
inline constexpr double kRecordFalseAlarm = 0.01;
/// Marks the tests that fail by Holm's method at kRecordFalseAlarm for all together.
void judge_record(std::vector<EffectTest>& tests);
/// test_state(), judged.
/// @param largest  where a test fails: "fine map of X at 35 degrees", which is furthest from the record
std::vector<EffectTest> test_run(const RunInformation& run, const InRunFit& found, const StageState& before,
                                 const Repeatabilities& repeatabilities, std::string& largest);

/// Two states of one stage: for each part, how they differ against the covariance of the difference.
/// @param is_continued  the later state began with the earlier one as its prior; else they are independent
/// @param earlier  grown to the time of the later one
std::vector<EffectTest> compare_states(const StageState& earlier, const StageState& later, bool is_continued);

/// Options of a fit whose stage is that of a record, some months after its last learning.
MeasurementOptions with_record(const StageRecord& record, double months);
/// The same at the time of a run; the sizes that runs state where no record is used.
MeasurementOptions options_of(const StageRecordInUse& use);

/// The fit of one item from the whole measurement, as joint_result() takes it: the line response with its
/// covariance and shares, the unknowns and the step errors of the item's first run; noise, residuals and
/// tests are those of the item's own fit in that run, and so is chi2 where there are several items.
/// @param own    that fit
/// @param first  the item in its first run
EffectFit common_fit(const EffectFit& own, const MeasuredItem& first, const MeasurementFit& fit);

}  // namespace abcal
