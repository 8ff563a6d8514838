#include "sim/firmware/xps_gathering.h"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>

#include "drivers/text/names.h"

namespace abcal::sim {

std::optional<XpsGathering::Kind> XpsGathering::kind_of(std::string_view name) {
  constexpr auto kKinds = names<Kind>({{Kind::kCurrentPosition, "CurrentPosition"},
                                       {Kind::kSetpointPosition, "SetpointPosition"},
                                       {Kind::kFollowingError, "FollowingError"},
                                       {Kind::kCurrentVelocity, "CurrentVelocity"},
                                       {Kind::kSetpointVelocity, "SetpointVelocity"}});
  const std::size_t dot = name.rfind('.');
  return dot == std::string_view::npos ? std::nullopt : kKinds.value(name.substr(dot + 1));
}

void XpsGathering::configure(std::vector<Quantity> quantities) {
  quantities_ = std::move(quantities);
  clear();
}

void XpsGathering::clear() {
  samples_.clear();
  next_.reset();
  wanted_ = 0;
}

void XpsGathering::run(std::size_t count, unsigned divisor, Clock::Instant now) {
  samples_.clear();
  wanted_ = count;
  period_ = kServoCycle * divisor;
  next_ = now;
}

void XpsGathering::resume(Clock::Instant now) {
  if (samples_.size() < wanted_) next_ = now;
}

void XpsGathering::sample_until(Clock::Instant now, const Measure& measure) {
  while (next_ && *next_ <= now) {
    take_one(*next_, measure);
    *next_ += period_;
    if (samples_.size() >= wanted_) next_.reset();
  }
}

void XpsGathering::take_one(Clock::Instant now, const Measure& measure) {
  if (samples_.size() >= capacity()) return;
  std::vector<double>& values = samples_.emplace_back();
  for (const Quantity& each : quantities_) values.push_back(measure(each, now));
}

std::string XpsGathering::line(std::size_t index) const {
  std::string text;
  for (const double value : samples_.at(index))
    text += fmt::format("{}{:.9g}", text.empty() ? "" : ";", value);
  return text;
}

}  // namespace abcal::sim
