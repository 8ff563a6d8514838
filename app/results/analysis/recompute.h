#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/results/analysis/analyses.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// Stores an analysis of an item with its closed run.
/// @throws RunFileError
void keep_analysis(ResultsFile& results, const std::string& utc, const CalibrationResult& result,
                   const StoredRun& run);

/// A stored analysis with its JSON; discarded JSON where the text is none.
struct ParsedAnalysis {
  StoredAnalysis stored;
  nlohmann::json json;
};

/// The analyses stored for all items of a run, oldest first.
/// @throws RunFileError
std::vector<ParsedAnalysis> parsed_analyses(const std::filesystem::path& run);

/// Recomputes the content of a run beyond its readings: its plan from its bench file, whether every planned
/// angle was measured where it was planned, and the stored analyses from the dwells.
/// @param bench    the bench file of the run; null: this program cannot read it, and the plan is not compared
/// with it
/// @param results  the present analyses, one for each estimator
/// @param analyses  the stored ones of all items of the run
std::vector<IntegrityCheck> recompute(const std::filesystem::path& run, const StoredRun& stored,
                                      const BenchConfig* bench, const std::vector<CalibrationResult>& results,
                                      const std::vector<ParsedAnalysis>& analyses);

/// All checks of a run: verify_run() and recompute(). Reads and analyses the run.
/// @throws RunFileError if the file is no run file at all
std::vector<IntegrityCheck> verify_and_recompute(const std::filesystem::path& run);

/// The stored analyses of a measurement, from the dwells of its runs.
std::vector<IntegrityCheck> check_analyses(const std::filesystem::path& path, const AnalysedRun& run);

/// All checks of a measurement: those of each run beyond its own analyses, and check_analyses().
std::vector<IntegrityCheck> verify_measurement(const std::filesystem::path& path, const AnalysedRun& run);

}  // namespace abcal
