#pragma once

#include <string>

#include "app/studies/calibration/calibration_study.h"

namespace abcal {

/// `abcal simulate calibration`: prints the study; exit code 1 where a limit is not kept.
/// @param figures  folder for figures of the ranks; empty: none
int simulate_calibration(const CalibrationOptions& options, bool json, const std::string& figures);

/// `abcal simulate calibration --power`: prints what runs notice of effects that are not as stated.
int simulate_power(const CalibrationOptions& options, bool json);

}  // namespace abcal
