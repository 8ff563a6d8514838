#pragma once

#include <array>
#include <optional>
#include <string>

namespace abcal {

/// What a bench file says of a stage, as far as a driver needs it.
struct StageSettings {
  std::array<std::string, 2> axis_names{"1", "2"};       ///< The controller's names of X and Z.
  std::array<std::optional<double>, 2> speed_deg_per_s;  ///< Absent: as the controller has it.
  std::string address;                                   ///< Of a controller in a daisy chain; empty: none.
};

/// What a bench file says of an accelerometer, as far as a driver needs it.
struct AccelerometerSettings {
  double rate_hz = 100.0;
  std::optional<double> full_scale;          ///< In the output unit, where the instrument does not say.
  std::optional<double> link_bytes_per_s{};  ///< What the link carries, where known (a UART: baud / 10).
};

}  // namespace abcal
