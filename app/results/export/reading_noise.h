#pragma once

#include <filesystem>
#include <optional>

#include "app/results/export/constants.h"

namespace abcal {

/// White noise of the single readings of a run, from their Allan deviation inside the dwells: at the
/// averaging time nearest to 1 s of which each dwell has at least five, averaged over all dwells. Worst
/// output.
/// @param item  of a run with several, from 1
/// @return nothing for a run without readings or with dwells that are too short
/// @throws RunFileError
std::optional<ReadingNoise> noise_of_readings(const std::filesystem::path& run, int item = 1);

}  // namespace abcal
