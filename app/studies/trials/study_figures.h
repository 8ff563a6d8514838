#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "protocol/uncertainty/simulation_sets.h"

namespace abcal {

/// Writes the paper's figures of a study as SVG and PNG by gnuplot: of set 1 figures 1 and 2, of set 2
/// figures 3 and 4 (readings against angle, and residuals of the ABC fit). Symbols as in the paper: U red +,
/// V green x, W blue.
/// @returns the files written
/// @throws std::invalid_argument for a set without figures
/// @throws std::runtime_error if gnuplot is not installed or fails, or a file cannot be written
std::vector<std::filesystem::path> write_study_figures(const StudyResult& study,
                                                       const std::filesystem::path& folder);

/// gnuplot's script of one figure, data included; `terminal` as gnuplot names it.
std::string figure_script(const SimulatedReadings& readings, bool residuals, const std::string& terminal,
                          const std::string& output);

}  // namespace abcal
