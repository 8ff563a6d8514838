#pragma once

#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

#include "app/results/analysis/estimators.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/quantities/quantity_groups.h"

namespace abcal {

/// Decimals that show two digits of the uncertainty; negative from 99.5 on: -1 for tens.
int decimals_for(double uncertainty);

/// A number rounded to that place: 1234.5 with -2 decimals is "1200".
std::string with_decimals(double value, int decimals, bool with_sign = false);

/// "not usable", "doubtful", "usable".
std::string verdict_words(Verdict verdict);

/// Value and standard uncertainty to two digits of the latter: "+1.0845574 +- 0.0000012".
std::string value_with_uncertainty(const Quantity& quantity);

/// The result as text: verdict first, then every quantity with uncertainty and unit, then the diagnostics.
/// Colours as `stream` allows.
std::string result_text(const CalibrationResult& result, std::FILE* stream);

/// Several estimators of one run side by side, with their differences from the one that is reported in units
/// of the combined standard uncertainty.
std::string comparison_text(const std::vector<CalibrationResult>& results, std::string_view estimator);

}  // namespace abcal
