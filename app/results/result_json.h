#pragma once

#include <nlohmann/json.hpp>

#include "protocol/analysis/calibration_result.h"

namespace abcal {

/// The result as one JSON object, schema abcal.result/1 (docs/architecture.md). Numbers that were not
/// determined are null.
nlohmann::ordered_json result_json(const CalibrationResult& result);

}  // namespace abcal
