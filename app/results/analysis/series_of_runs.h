#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/results/analysis/analyses.h"
#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// Items in runs on one stage, run by run.
struct RunsOfStage {
  std::vector<std::string> files;
  std::vector<StoredRun> runs;
  std::vector<std::string> sha256;  ///< Hashes of the files.
  std::vector<ItemInRun> places;    ///< Numbers of item and run.
  std::vector<RunRecord> records() const;
};

/// Loads runs in the order of their beginning; a measurement stands for its runs.
/// @throws std::invalid_argument one file twice; no run file; items of one run that cannot be told apart;
/// another stage
RunsOfStage load_runs_of_stage(const std::vector<std::string>& files);

/// "Maker Model, serial number 1234".
std::string item_of(const StoredRun& run);

/// The joint results of the items of several runs from one fit, each as it is mounted in the first of them.
/// An item that is doubtful in a run alone is evaluated by itself, and so is each where they contradict each
/// other about the stage. The results of each run alone are compared with them: an ABC result that
/// contradicts one makes it doubtful.
/// @param record  of the stage; absent: the one that all runs keep, if they do
/// @throws as load_runs_of_stage(), and the exceptions of the fit; std::invalid_argument: a run of which what
/// stays the same in a measurement differs (the unit, g, the settings and registers of the item), all of them
/// at once; a record that one of the runs taught
AnalysedRun analyse_series_of_runs(const std::vector<std::string>& files,
                                   const std::optional<StageRecord>& record);

}  // namespace abcal
