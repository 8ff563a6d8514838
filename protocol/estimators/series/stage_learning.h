#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/series/series_fit.h"

namespace abcal {

/// Findings of a learning.
struct StageLearned {
  /// State, sizes, repeatabilities and growth; the caller adds identity and learnings.
  StageRecord record;
  SeriesFit fit;
  /// The state against what was known before: a test for each part. Empty at the first learning.
  std::vector<EffectTest> changes;
};

/// A record from the runs of one series; with `before` a later one, in which the state of the earlier record
/// is the prior, less well known by its growth.
/// @param months  from the last learning of `before` to these runs
/// @throws as fit_series()
StageLearned learn_stage(std::span<const SeriesRun> runs, const std::optional<StageRecord>& before,
                         double months);

/// The test of a record by one run: for each part of the stage how its errors in this run differ from what
/// the record predicts, against the covariance of that difference. A common turn of the whole stage about X
/// is not tested: no run shows it.
/// @param before  the record's state at the time of the run
std::vector<EffectTest> test_state(const RunInformation& run, const SeriesRunResult& found,
                                   const StageState& before, const Repeatabilities& repeatabilities);

/// Probability that any test of a sound run contradicts its record.
inline constexpr double kRecordFalseAlarm = 0.01;
/// Marks the tests that fail by Holm's method at kRecordFalseAlarm for all together.
void judge_record(std::vector<EffectTest>& tests);

/// Two states of one stage: for each part, how they differ against the covariance of the difference.
/// @param is_continued  the later state began with the earlier one as its prior; else they are independent
/// @param earlier  grown to the time of the later one
std::vector<EffectTest> compare_states(const StageState& earlier, const StageState& later, bool is_continued);

/// Options of a fit whose stage is that of a record, some months after its last learning.
SeriesOptions with_record(const StageRecord& record, double months);

/// The fit of the first run's item from all runs of a series, as a common fit of several items gives it
/// (joint_result.h): the line response with its covariance and shares, the unknowns and the step errors;
/// chi2 is that of the common fit, noise, residuals and tests are those of the run's own fit.
/// @param own  that fit
EffectFit common_fit(const EffectFit& own, const RunInformation& first, const SeriesFit& series);

/// One item's own fit with a record as the prior of the stage.
struct FitWithRecord {
  bool converged = false;
  EffectFit fit;                  ///< As common_fit().
  std::vector<EffectTest> tests;  ///< Judged.
  std::string largest;  ///< "fine map of X at 35 degrees": furthest from the record, where a test fails.
};
FitWithRecord fit_with_record(const CollectedReadings& data, const EffectSolution& own,
                              const StageRecord& record, double months);

}  // namespace abcal
