#pragma once

#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/thermal_chamber.h"

namespace abcal {

/// [chamber]: the thermal chamber around the stage. No driver: no chamber.
struct ChamberConfig {
  std::string driver, port;
  std::optional<int> baud;
  ChamberSettings settings;
  std::optional<double> min_degc, max_degc;  ///< Limits narrower than those of its hardware.
  bool dry_gas = false;                      ///< Dry air or nitrogen is on: nothing can condense.
  double poll_s = 2.0;

  bool present() const { return !driver.empty(); }

  bool operator==(const ChamberConfig&) const = default;
};

/// [temperature]: the series of `abcal temperature`.
struct TemperatureConfig {
  std::vector<double> set_points_degc;  ///< In one direction; empty: no series.
  double reference_degc = 23.0;
  bool down = true;                   ///< Measure back through the same points, too.
  double ramp_k_per_min = 1.0;        ///< 0: as fast as the chamber can.
  double air_window_k = 1.5;          ///< Largest deviation of the air from the set point during a soak.
  double soak_min_s = 1800.0;         ///< Shortest soak, with the air in its window.
  double soak_rate_k_per_min = 0.02;  ///< Limit of the rate of the item's sensor at the end of a soak.
  double soak_span_s = 300.0;         ///< Time over which this rate is determined.
  double soak_max_s = 14'400.0;       ///< Longest wait, ramp included; then the series ends.
  std::optional<double> item_min_degc, item_max_degc;  ///< Limits that the item withstands.
  double dew_point_margin_k = 2.0;                     ///< Least difference of air and dew point.
  bool pause = true;            ///< Pause compressor or fan in dwells, if the chamber can.
  std::string end = "ambient";  ///< Final state of the chamber: "hold", "ambient", "off".

  bool wanted() const { return !set_points_degc.empty(); }
  ChamberPolicy policy() const {
    return end == "hold"  ? ChamberPolicy::kHold
           : end == "off" ? ChamberPolicy::kOff
                          : ChamberPolicy::kAmbient;
  }

  bool operator==(const TemperatureConfig&) const = default;
};

}  // namespace abcal
