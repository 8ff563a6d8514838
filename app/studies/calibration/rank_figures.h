#pragma once

#include <filesystem>
#include <vector>

#include "app/studies/calibration/calibration_study.h"

namespace abcal {

/// Writes one SVG of each kind by gnuplot: how often the truth had each rank in its distribution, for each
/// group of outputs, with the limits of 95 % of flat ranks.
/// @returns the files written
/// @throws std::runtime_error if gnuplot is not installed or fails, or a file cannot be written
std::vector<std::filesystem::path> write_rank_figures(const CalibrationStudy& study,
                                                      const std::filesystem::path& folder);

}  // namespace abcal
