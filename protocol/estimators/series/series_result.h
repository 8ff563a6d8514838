#pragma once

#include <memory>
#include <span>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/series/stage_learning.h"

namespace abcal {

/// The joint result of one item's own fit, with the record of its stage as the prior of the stage. A run that
/// contradicts the record is doubtful.
CalibrationResult result_with_record(const RunRecord& record, const ItemFit& own);

/// The sizes of a run that rest on statements alone where a record of its stage is used: those of the stage
/// count as stated, by the record.
EffectSizes sizes_with_record(EffectSizes sizes);

/// The runs of a series, each with its own fit.
struct SeriesRuns {
  std::vector<std::unique_ptr<ItemFit>> own;
  std::vector<CalibrationResult> alone;  ///< The result of each run alone, without a record.
  std::vector<RunInformation> information;
  std::vector<SeriesRun> runs;  ///< They refer to `information`.
};

/// Fits each run alone.
/// @param items  for each record the number of its item, from 0 in the order of their first runs
/// @throws UnusableData a run without a solution, which it names
SeriesRuns fit_each_run(std::span<const RunRecord> records, std::span<const int> items,
                        const JointOptions& options);

/// The result of runs of one item in several mountings, from one fit; as it is mounted in the first run. A
/// record of the stage is that of the first run. It is doubtful if a run alone is, or if the fit's chi2 is
/// too large.
/// @throws as fit_each_run() and fit_series()
CalibrationResult analyse_series(std::span<const RunRecord> records, const JointOptions& options);

}  // namespace abcal
