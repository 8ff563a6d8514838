#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "app/document/document.h"
#include "protocol/temperature/temperature_fit.h"

namespace abcal {

/// A series over temperature, and where it came from.
struct TemperatureReport {
  std::vector<std::filesystem::path> files;  ///< Files of the points, in their order.
  std::string item, unit;
  TemperatureResult result;
};

/// Points, coefficients, polynomials, hysteresis and closure; as a page also the curves with their bands.
Document temperature_document(const TemperatureReport& report);

/// Schema abcal.temperature/1.
nlohmann::ordered_json temperature_json(const TemperatureReport& report);

}  // namespace abcal
