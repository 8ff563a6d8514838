#pragma once

#include <cstdio>
#include <string>

#include "app/commands/run.h"
#include "app/results/analysis/analyses.h"

namespace abcal {

/// Compares a result with the true values of a simulated bench, and prints the comparison.
/// @param stream  stdout, or stderr where standard output belongs to a program
TruthComparison show_truth(const std::string& bench_file, const StoredRun& run,
                           const CalibrationResult& result, std::FILE* stream);

/// Prints the results of runs that were fitted together, and stores them with a measurement.
/// @param files  the measurement, or the runs as a command takes them
/// @param item   from 1: this one alone; 0: all
/// @return the exit code of the program
int print_measurement(const AnalysedRun& run, const std::string& files, ResultForm form, int item = 0);

}  // namespace abcal
