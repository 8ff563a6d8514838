#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/results/analysis/analyses.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// Runs on one stage, each of one item.
struct RunsOfStage {
  std::vector<std::string> files;
  std::vector<StoredRun> runs;
  std::vector<std::string> sha256;  ///< Hashes of the files.
  std::vector<int> items;           ///< Number of each run's item, from 0 in the order of their first runs.
  std::vector<RunRecord> records() const;
};

/// Loads runs in the order of their beginning.
/// @param one_item  refuses runs of different items
/// @throws std::invalid_argument one file twice; no run file; a run of several items; another stage; an item
/// that is not identified, or another one
RunsOfStage load_runs_of_stage(const std::vector<std::string>& files, bool one_item);

/// "Maker Model, serial number 1234".
std::string item_of(const StoredRun& run);

/// The joint result of runs of one item in several mountings, with the first of them as it was loaded.
/// @throws as load_runs_of_stage(), and the exceptions of the fit
AnalysedItem analyse_series_of_runs(const std::vector<std::string>& files,
                                    const std::optional<StageRecord>& record);

}  // namespace abcal
