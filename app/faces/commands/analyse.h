#pragma once

#include <cstdio>
#include <string>

#include "app/results/estimates/analyses.h"

namespace abcal {

/// Compares a result with the true values of a simulated bench, and prints the comparison.
/// @param stream  stdout, or stderr where standard output belongs to a program
TruthComparison show_truth(const std::string& bench_file, int item, const CalibrationResult& result,
                           std::FILE* stream);

}  // namespace abcal
