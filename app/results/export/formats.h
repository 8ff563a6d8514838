#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "app/results/export/constants.h"
#include "app/results/export/temperature_constants.h"

namespace abcal {

/// A form in which other programs take the constants of an accelerometer.
struct ExportFormat {
  std::string_view name;   ///< "px4"
  std::string_view words;  ///< Programs that read it, and the rule that they apply.
  /// @throws std::invalid_argument where the constants do not fit the format
  std::function<std::string(const CorrectionConstants& constants)> write;
  bool is_text = true;  ///< False: it belongs into a file, not onto a terminal.
  /// Writes a series over temperature; empty: the format holds constants of one temperature.
  std::function<std::string(const TemperatureConstants& constants)> write_over_temperature{};
  /// Contents of the format that this file lacks, with the reason; empty: none.
  std::function<std::string(const CorrectionConstants& constants)> left_out{};
};

/// One entry for each: json, csv, mat, c, px4, ardupilot, ros, kalibr, imucal.
const std::vector<ExportFormat>& export_formats();

/// @throws std::invalid_argument naming the existing formats
const ExportFormat& export_format(std::string_view name);

}  // namespace abcal
