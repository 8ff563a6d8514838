#pragma once

#include <memory>
#include <span>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/measurement/stage_learning.h"

namespace abcal {

/// The joint result of one item's own fit, with the record of its stage as the prior of the stage. A run that
/// contradicts the record is doubtful.
CalibrationResult result_with_record(const RunRecord& record, const ItemFit& own);

/// The result of an item from a whole measurement, as it is mounted in its first run.
/// @param record   of that run; its record of the stage is that of the options
/// @param own      its own fit in that run
/// @param first    the item in that run
/// @param options  those of the fit
CalibrationResult result_from(const RunRecord& record, const ItemFit& own, const MeasuredItem& first,
                              const MeasurementFit& fit, const MeasurementOptions& options);

/// The sizes of a run that rest on statements alone where a record of its stage is used: those of the stage
/// count as stated, by the record.
EffectSizes sizes_with_record(EffectSizes sizes);

/// One item in one run of a measurement, by numbers from 0: the item in the order of their first runs.
struct ItemInRun {
  int item = 0, run = 0;
};

bool are_of_one_run(std::span<const ItemInRun> places);

/// The items of several runs, each with its own fit in each run.
struct SeriesRuns {
  std::vector<std::unique_ptr<ItemFit>> own;
  std::vector<CalibrationResult> alone;  ///< The result of each item in each run alone, without a record.
  std::vector<RunInformation> information;
  std::vector<MeasuredItem> runs;  ///< They refer to `information`.
};

/// Fits each item of each run alone.
/// @param records  run by run; they must outlive the result
/// @param places   of each record
/// @throws UnusableData a run without a solution, which it names
SeriesRuns fit_each_run(std::span<const RunRecord> records, std::span<const ItemInRun> places,
                        const JointOptions& options);

/// The results of items from one fit of all their runs, each as it is mounted in its first run.
struct SeriesResult {
  std::vector<CalibrationResult> items;
  Eigen::MatrixXd covariance;  ///< 12 outputs for each item, with the voltmeters that they share.
  bool runs_agree = true;      ///< chi2 of the common fit. If not, each result is doubtful.
};

/// A record of the stage is that of the first run. A result is doubtful if the item is in a run alone, or if
/// the fit's chi2 is too large.
/// @param items  numbers of the items that the fit has, ascending; what is said of others is left out
/// @throws UnusableData as fit_measurement(), or no convergence
SeriesResult analyse_series(std::span<const RunRecord> records, const SeriesRuns& each,
                            std::span<const int> items);

}  // namespace abcal
