#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "app/export/constants.h"
#include "app/export/temperature_constants.h"

namespace abcal {

/// A form in which other programs take the constants of an accelerometer.
struct ExportFormat {
  std::string_view name;   ///< "px4"
  std::string_view words;  ///< Who reads it, and by which rule.
  /// @throws std::invalid_argument where the constants do not fit the format
  std::function<std::string(const CorrectionConstants& constants)> write;
  bool is_text = true;  ///< Else it belongs into a file, not onto a terminal.
  /// Of a series over temperature; empty: the format holds constants of one temperature.
  std::function<std::string(const TemperatureConstants& constants)> write_over_temperature{};
  /// What the format would hold and this file does not, with the reason; returns an empty text for nothing.
  std::function<std::string(const CorrectionConstants& constants)> left_out{};
};

/// One entry for each: json, csv, mat, c, px4, ardupilot, ros, kalibr, imucal.
const std::vector<ExportFormat>& export_formats();

/// @throws std::invalid_argument naming the formats there are
const ExportFormat& export_format(std::string_view name);

}  // namespace abcal
