#pragma once

#include <string>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// How far one result is from another of the same item.
Apart apart(const CalibrationResult& one, const CalibrationResult& other);

/// Makes a joint result doubtful from which an ABC result of the same readings, or of some of them, is
/// further away than chance explains: ABC holds where the model of the stage or of the item does not.
/// @param run  of which the ABC result is, in a measurement of several; empty: both are of one run
void object_to_disagreement(const Apart& apart, const std::string& run, CalibrationResult& joint);

}  // namespace abcal
