#pragma once

#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "app/commands/run.h"
#include "app/results/analysis/analyses.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// Compares a result with the true values of a simulated bench, and prints the comparison.
/// @param stream  stdout, or stderr where standard output belongs to a program
TruthComparison show_truth(const std::string& bench_file, const StoredRun& run,
                           const CalibrationResult& result, std::FILE* stream);

/// Fits runs of one item on one stage together, and prints the result.
/// @return the exit code of the program
/// @throws as analyse_series_of_runs()
int print_series(const std::vector<std::string>& files, const std::optional<StageRecord>& record,
                 ResultForm form);

}  // namespace abcal
