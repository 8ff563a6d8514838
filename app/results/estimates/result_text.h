#pragma once

#include <cstdio>
#include <string>
#include <string_view>
#include <vector>

#include "app/results/estimates/estimators.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// An output with its symbol: "s_ux", "s_u", "phi_uv", "O_u".
struct NamedQuantity {
  std::string name;
  Quantity quantity;
};

/// The 18 outputs in the order of the reports: matrix row by row, intrinsic sensitivities, intrinsic angles,
/// offsets. A value that an estimator does not give is NaN.
std::vector<NamedQuantity> outputs(const CalibrationResult& result);

/// Decimals that show two digits of the uncertainty; negative from 99.5 on: -1 for tens.
int decimals_for(double uncertainty);

/// A number rounded to that place: 1234.5 with -2 decimals is "1200".
std::string with_decimals(double value, int decimals, bool with_sign = false);

/// "not usable", "doubtful", "usable".
std::string verdict_words(Verdict verdict);

/// "+1.084557(12)e0"-style would hide the uncertainty: value and standard uncertainty to two digits of the
/// latter,
/// "+1.0845574 +- 0.0000012".
std::string value_with_uncertainty(const Quantity& quantity);

/// The result as text: verdict first, then every quantity with uncertainty and unit, then the diagnostics.
/// Colours as `stream` allows.
std::string result_text(const CalibrationResult& result, std::FILE* stream);

/// Several estimators of one run side by side, with their differences from the one that is reported in units
/// of the combined standard uncertainty.
std::string comparison_text(const std::vector<CalibrationResult>& results, std::string_view estimator);

}  // namespace abcal
