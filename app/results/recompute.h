#pragma once

#include <filesystem>
#include <vector>

#include "app/bench/bench_config.h"
#include "protocol/analysis/calibration_result.h"
#include "protocol/record/run_file.h"
#include "protocol/record/verify.h"

namespace abcal {

/// Keeps an analysis with its closed run.
/// @param item  of a run with several items: whose, from 1; 0: the run has one
/// @throws RunFileError
void keep_analysis(ResultsFile& results, const std::string& utc, const CalibrationResult& result, int item);

/// What a run states beyond its readings, computed again: its plan from its bench file, whether every planned
/// angle was measured where it was planned, and the stored analyses from the dwells.
/// @param bench    the bench file of the run; null: this program cannot read it, and the plan is not compared
/// with it
/// @param results  the analyses of now, one an estimator; of several items those of results_of_item()
std::vector<IntegrityCheck> recompute(const std::filesystem::path& run, const StoredRun& stored,
                                      const BenchConfig* bench,
                                      const std::vector<CalibrationResult>& results);

/// Everything that is checked of a run: verify_run() and recompute(). Reads and analyses the run.
/// @throws RunFileError if the file is no run file at all
std::vector<IntegrityCheck> verify_and_recompute(const std::filesystem::path& run);

}  // namespace abcal
