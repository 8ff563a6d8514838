#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// A number; null if it is absent or not finite.
nlohmann::ordered_json json_number(const std::optional<double>& value);

/// The result as one JSON object, schema abcal.result/1 (docs/architecture.md). Numbers that were not
/// determined are null.
nlohmann::ordered_json result_json(const CalibrationResult& result);

/// The object of a single item; for several, an object of the same schema with that of each under `items`.
nlohmann::ordered_json json_of_items(std::vector<nlohmann::ordered_json> items);

}  // namespace abcal
