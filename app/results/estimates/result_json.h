#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// A number; null where there is none, and where it is not finite.
nlohmann::ordered_json json_number(const std::optional<double>& value);

/// The result as one JSON object, schema abcal.result/1 (docs/architecture.md). Numbers that were not
/// determined are null.
nlohmann::ordered_json result_json(const CalibrationResult& result);

/// The object of the only item; of several, one with the object of each under `items`, and the same schema.
nlohmann::ordered_json json_of_items(std::vector<nlohmann::ordered_json> items);

}  // namespace abcal
