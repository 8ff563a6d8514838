#pragma once

#include <deque>
#include <optional>
#include <string>

#include "app/bench_file/chamber_config.h"
#include "drivers/instrument/thermal_chamber.h"

namespace abcal {

/// Whether the item has taken the temperature of a point: the air is at the set point for the shortest soak,
/// and the item's own sensor moves slower than the limit.
class SoakRule {
 public:
  SoakRule(const TemperatureConfig& config, double set_degc) : config_(config), set_degc_(set_degc) {}

  /// Adds one reading. `item_degc`: nullopt if the item has no sensor; then only the air counts.
  void add(double time_s, double air_degc, std::optional<double> item_degc);
  bool reached() const;
  /// The item's rate over the span in K/min; nullopt until the readings cover the span.
  std::optional<double> rate_k_per_min() const;
  std::optional<double> item_degc() const;
  double air_degc() const { return air_degc_; }
  /// "soaked for 41 min, the item at 26.02 degC moves by +0.004 K/min, the air at 23.00 degC"
  std::string words() const;

 private:
  struct Temperature {
    double time_s = 0.0;
    double item_degc = 0.0;
  };
  TemperatureConfig config_;
  double set_degc_;
  double air_degc_ = 0.0, now_s_ = 0.0;
  std::optional<double> in_window_since_s_;
  bool has_sensor_ = false;
  std::deque<Temperature> readings_;  ///< Readings within the span, and the last one before it.
};

}  // namespace abcal
