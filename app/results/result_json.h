#pragma once

#include <nlohmann/json.hpp>
#include <optional>

#include "protocol/analysis/calibration_result.h"

namespace abcal {

/// A number; null where there is none, and where it is not finite.
nlohmann::ordered_json json_number(const std::optional<double>& value);

/// The result as one JSON object, schema abcal.result/1 (docs/architecture.md). Numbers that were not
/// determined are null.
nlohmann::ordered_json result_json(const CalibrationResult& result);

}  // namespace abcal
