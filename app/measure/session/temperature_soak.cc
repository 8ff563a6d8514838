#include "app/measure/session/temperature_soak.h"

#include <fmt/format.h>

#include <cmath>

namespace abcal {
namespace {

constexpr double kSecondsPerMinute = 60.0;

}  // namespace

void SoakRule::add(double time_s, double air_degc, std::optional<double> item_degc) {
  now_s_ = time_s;
  air_degc_ = air_degc;
  if (std::abs(air_degc - set_degc_) > config_.air_window_k) {
    in_window_since_s_.reset();
  } else if (!in_window_since_s_) {
    in_window_since_s_ = time_s;
  }
  if (!item_degc) return;
  has_sensor_ = true;
  readings_.push_back({time_s, *item_degc});
  // The last reading before the span stays, so that the readings cover it however far apart they are.
  while (readings_.size() > 1 && readings_[1].time_s <= time_s - config_.soak_span_s) readings_.pop_front();
}

std::optional<double> SoakRule::rate_k_per_min() const {
  if (readings_.size() < 3 || readings_.back().time_s - readings_.front().time_s < config_.soak_span_s)
    return std::nullopt;
  double mean_s = 0.0, mean_degc = 0.0;
  for (const Temperature& reading : readings_) {
    mean_s += reading.time_s / static_cast<double>(readings_.size());
    mean_degc += reading.item_degc / static_cast<double>(readings_.size());
  }
  double above = 0.0, below = 0.0;
  for (const Temperature& reading : readings_) {
    above += (reading.time_s - mean_s) * (reading.item_degc - mean_degc);
    below += (reading.time_s - mean_s) * (reading.time_s - mean_s);
  }
  return above / below * kSecondsPerMinute;
}

std::optional<double> SoakRule::item_degc() const {
  return readings_.empty() ? std::nullopt : std::optional(readings_.back().item_degc);
}

bool SoakRule::reached() const {
  if (!in_window_since_s_ || now_s_ - *in_window_since_s_ < config_.soak_min_s) return false;
  if (!has_sensor_) return true;
  const auto rate = rate_k_per_min();
  return rate && std::abs(*rate) < config_.soak_rate_k_per_min;
}

std::string SoakRule::words() const {
  std::string text =
      in_window_since_s_
          ? fmt::format("soaked for {:.0f} min", (now_s_ - *in_window_since_s_) / kSecondsPerMinute)
          : fmt::format("the air is not within {:g} K of the set point", config_.air_window_k);
  if (has_sensor_) {
    const auto rate = rate_k_per_min();
    text += fmt::format(", the item at {:.2f} degC {}", readings_.back().item_degc,
                        rate ? fmt::format("moves by {:+.4f} K/min", *rate) : std::string("is watched"));
  } else {
    text += ", the item tells no temperature";
  }
  return text + fmt::format(", the air at {:.2f} degC", air_degc_);
}

}  // namespace abcal
