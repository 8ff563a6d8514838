#pragma once

#include <cstdio>
#include <string>
#include <vector>

#include "protocol/analysis/calibration_result.h"

namespace abcal {

/// "+1.084557(12)e0"-style would hide the uncertainty: value and standard uncertainty to two digits of the
/// latter,
/// "+1.0845574 +- 0.0000012".
std::string value_with_uncertainty(const Quantity& quantity);

/// The result as people read it: verdict first, then every quantity with uncertainty and unit, then what the
/// diagnostics say. Colours as `stream` allows.
std::string result_text(const CalibrationResult& result, std::FILE* stream);

/// Several estimators of one run side by side, with their differences from the first in units of the combined
/// standard uncertainty.
std::string comparison_text(const std::vector<CalibrationResult>& results);

}  // namespace abcal
