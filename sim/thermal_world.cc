#include "sim/thermal_world.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace abcal::sim {
namespace {

/// Factor by which air that nothing drives loses its temperature more slowly.
constexpr double kIdleLagFactor = 20.0;
/// Two lags that are equal have no solution of this form.
constexpr double kSmallestDifference = 1e-6;
/// The play of the hysteresis is followed in steps of this.
constexpr double kPlayStepS = 5.0;

/// Pressure of saturated water vapour over water, hPa (Magnus).
double saturation_hpa(double degc) {
  return 6.112 * std::exp(17.62 * degc / (243.12 + degc));
}

}  // namespace

ThermalWorld::ThermalWorld(const ChamberTruth& truth, double room_degc, Clock::Instant start)
    : truth_(truth), room_degc_(room_degc) {
  const bool can_be = truth.air_lag_s > 0.0 && truth.item_lag_s > 0.0 && truth.hysteresis_width_degc > 0.0;
  if (!can_be) throw std::invalid_argument("simulated chamber: lags and width of the hysteresis must be > 0");
  const State state{room_degc, room_degc + truth.self_heating_degc};
  segments_.push_back({start, {.target_degc = room_degc}, state, state.item, 0.0});
}

const ThermalWorld::Segment& ThermalWorld::segment_at(Clock::Instant t) const {
  for (auto segment = segments_.rbegin(); segment != segments_.rend(); ++segment)
    if (segment->start <= t) return *segment;
  return segments_.front();
}

double ThermalWorld::goal(const Segment& segment) const {
  const bool drives = segment.command.running && !segment.command.paused;
  return drives ? segment.command.target_degc : room_degc_;
}

double ThermalWorld::air_lag_s(const Segment& segment) const {
  const bool drives = segment.command.running && !segment.command.paused;
  return drives ? truth_.air_lag_s : kIdleLagFactor * truth_.air_lag_s;
}

ThermalWorld::State ThermalWorld::after(const State& from, double p, double q, double seconds,
                                        double lag_s) const {
  double item_lag = truth_.item_lag_s;
  if (std::abs(item_lag - lag_s) < kSmallestDifference * lag_s) item_lag *= 1.0 + 2.0 * kSmallestDifference;
  const double air_constant = p - q * lag_s;
  const double air_decays = from.air - air_constant;
  const double item_constant = air_constant + truth_.self_heating_degc - q * item_lag;
  const double follows = air_decays * lag_s / (lag_s - item_lag);
  const double item_decays = from.item - item_constant - follows;
  const double air_left = std::exp(-seconds / lag_s), item_left = std::exp(-seconds / item_lag);
  return {air_constant + q * seconds + air_decays * air_left,
          item_constant + q * seconds + item_decays * item_left + follows * air_left};
}

ThermalWorld::State ThermalWorld::state_in(const Segment& segment, double seconds) const {
  seconds = std::max(0.0, seconds);
  const double lag = air_lag_s(segment);
  if (segment.ramp_s <= 0.0) return after(segment.state, goal(segment), 0.0, seconds, lag);
  const double slope = (goal(segment) - segment.state.air) / segment.ramp_s;
  const State ramped = after(segment.state, segment.state.air, slope, std::min(seconds, segment.ramp_s), lag);
  if (seconds <= segment.ramp_s) return ramped;
  return after(ramped, goal(segment), 0.0, seconds - segment.ramp_s, lag);
}

void ThermalWorld::command(const ChamberCommand& command, Clock::Instant t) {
  const Segment& before = segments_.back();
  if (t < before.start) throw std::invalid_argument("simulated chamber: commands must come in order of time");
  const double seconds = to_seconds(t - before.start);
  Segment next{t, command, state_in(before, seconds), play_in(before, seconds), 0.0};
  const bool drives = command.running && !command.paused;
  if (drives && command.rate_k_per_min && *command.rate_k_per_min > 0.0) {
    // A pause or a repeated command does not restart the ramp at another rate.
    next.ramp_s = std::abs(command.target_degc - next.state.air) / *command.rate_k_per_min * 60.0;
  }
  segments_.push_back(next);
  memo_ = {};
}

double ThermalWorld::set_point(Clock::Instant t) const {
  const Segment& segment = segment_at(t);
  const double seconds = to_seconds(t - segment.start);
  if (segment.ramp_s <= 0.0 || seconds >= segment.ramp_s) return segment.command.target_degc;
  return segment.state.air + (segment.command.target_degc - segment.state.air) * seconds / segment.ramp_s;
}

double ThermalWorld::air(Clock::Instant t) const {
  const Segment& segment = segment_at(t);
  return state_in(segment, to_seconds(t - segment.start)).air;
}

double ThermalWorld::item(Clock::Instant t) const {
  const Segment& segment = segment_at(t);
  return state_in(segment, to_seconds(t - segment.start)).item;
}

double ThermalWorld::humidity_percent(Clock::Instant t) const {
  const double now = air(t);
  return std::min(100.0, 100.0 * saturation_hpa(truth_.dew_point_degc) / saturation_hpa(now));
}

double ThermalWorld::moved_play(double play, double item) const {
  const double half = truth_.hysteresis_width_degc / 2.0;
  return std::clamp(play, item - half, item + half);
}

double ThermalWorld::play_in(const Segment& segment, double seconds) const {
  if (memo_.segment != &segment || static_cast<double>(memo_.steps) * kPlayStepS > seconds)
    memo_ = {&segment, 0, segment.play};
  const long steps = static_cast<long>(std::max(0.0, seconds) / kPlayStepS);
  // After some lags nothing moves any more.
  const double rest_s = segment.ramp_s + 40.0 * std::max(air_lag_s(segment), truth_.item_lag_s);
  while (memo_.steps < steps) {
    ++memo_.steps;
    if (static_cast<double>(memo_.steps) * kPlayStepS > rest_s) {
      memo_.steps = steps;
      break;
    }
    memo_.play =
        moved_play(memo_.play, state_in(segment, static_cast<double>(memo_.steps) * kPlayStepS).item);
  }
  return moved_play(memo_.play, state_in(segment, seconds).item);
}

double ThermalWorld::hysteresis(Clock::Instant t) const {
  const Segment& segment = segment_at(t);
  const double seconds = to_seconds(t - segment.start);
  const double half = truth_.hysteresis_width_degc / 2.0;
  return (state_in(segment, seconds).item - play_in(segment, seconds)) / half;
}

}  // namespace abcal::sim
