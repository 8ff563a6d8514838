#include "sim/axis_motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace abcal::sim {
namespace {

void require_positive(double value, const char* what) {
  if (!(value > 0.0) || !std::isfinite(value))
    throw std::invalid_argument(std::string("motion of a simulated axis: ") + what + " is " +
                                std::to_string(value) + ", required: a positive number");
}

}  // namespace

AxisMotion::AxisMotion(Angle position, Clock::Instant since)
    : start_(since), end_(since), planned_end_(since), start_position_(position), target_(position) {}

void AxisMotion::add_phase(double duration_s, double acceleration) {
  if (duration_s <= 0.0) return;
  Phase phase{duration_s, start_position_.deg(), start_velocity_, acceleration};
  if (phase_count_ > 0) {
    const Phase& before = phases_[static_cast<std::size_t>(phase_count_ - 1)];
    const double d = before.duration_s;
    phase.position_deg = before.position_deg + d * (before.velocity + 0.5 * before.acceleration * d);
    phase.velocity = before.velocity + before.acceleration * d;
  }
  phases_[static_cast<std::size_t>(phase_count_++)] = phase;
}

AxisMotion AxisMotion::move(Clock::Instant start, Angle position, double velocity_deg_per_s, Angle target,
                            const MotionLimits& limits) {
  if (!std::isfinite(target.deg()))
    throw std::invalid_argument("motion of a simulated axis: the target is not finite");
  require_positive(limits.speed_deg_per_s, "speed in deg/s");
  require_positive(limits.acceleration_deg_per_s2, "acceleration in deg/s2");
  require_positive(limits.deceleration_deg_per_s2, "deceleration in deg/s2");

  AxisMotion motion(position, start);
  motion.start_velocity_ = velocity_deg_per_s;
  motion.target_ = target;
  const double distance = target.deg() - position.deg();
  const double stopping =
      velocity_deg_per_s * std::abs(velocity_deg_per_s) / (2.0 * limits.deceleration_deg_per_s2);
  // Everything below is seen along the sense in which the motion ends: past the point of no return it
  // overshoots and returns.
  const double sense = distance - stopping < 0.0 ? -1.0 : 1.0;
  double d = sense * distance;
  double v0 = sense * velocity_deg_per_s;
  const double up = limits.acceleration_deg_per_s2;
  const double down = limits.deceleration_deg_per_s2;
  motion.peak_speed_ = std::abs(v0);

  // Moving the wrong way: it brakes first.
  double brake_s = 0.0;
  if (v0 < 0.0) {
    brake_s = -v0 / down;
    d += v0 * v0 / (2.0 * down);
    v0 = 0.0;
    motion.add_phase(brake_s, sense * down);
  }
  // (vp^2 - v0^2)/(2 up) + vp^2/(2 down) = d, the speed limit aside.
  double peak = std::sqrt(std::max(0.0, (d + v0 * v0 / (2.0 * up)) / (0.5 / up + 0.5 / down)));
  double first_acceleration = up;
  double cruise_s = 0.0;
  if (peak > limits.speed_deg_per_s || v0 > peak) {
    peak = std::min(std::max(peak, v0), limits.speed_deg_per_s);
    if (v0 > peak) first_acceleration = -down;
    const double rest = d - (peak * peak - v0 * v0) / (2.0 * first_acceleration) - peak * peak / (2.0 * down);
    cruise_s = peak > 0.0 ? std::max(0.0, rest / peak) : 0.0;
  }
  const double first_s = std::max(0.0, (peak - v0) / first_acceleration);
  const double last_s = peak / down;
  motion.add_phase(first_s, sense * first_acceleration);
  motion.add_phase(cruise_s, 0.0);
  motion.add_phase(last_s, -sense * down);
  motion.peak_speed_ = std::max(peak, motion.peak_speed_);
  if (distance != 0.0 || velocity_deg_per_s != 0.0) {
    motion.direction_ = sense < 0.0 ? -1 : 1;
    motion.end_ = motion.planned_end_ = start + from_seconds(brake_s + first_s + cruise_s + last_s);
  }
  return motion;
}

AxisMotion AxisMotion::halt(Clock::Instant start, Angle position, double velocity_deg_per_s,
                            const MotionLimits& limits) {
  require_positive(limits.deceleration_deg_per_s2, "deceleration in deg/s2");
  AxisMotion motion(position, start);
  if (velocity_deg_per_s == 0.0) return motion;
  const double down = limits.deceleration_deg_per_s2;
  const double brake_s = std::abs(velocity_deg_per_s) / down;
  motion.start_velocity_ = velocity_deg_per_s;
  motion.direction_ = velocity_deg_per_s < 0.0 ? -1 : 1;
  motion.target_ =
      position + Angle::degrees(velocity_deg_per_s * std::abs(velocity_deg_per_s) / (2.0 * down));
  motion.add_phase(brake_s, -motion.direction_ * down);
  motion.peak_speed_ = std::abs(velocity_deg_per_s);
  motion.end_ = motion.planned_end_ = start + from_seconds(brake_s);
  return motion;
}

void AxisMotion::stall_at(Clock::Instant instant) {
  if (end_ == start_ || instant >= end_) return;  // there is no motion that could stall
  stalled_since_ = std::max(instant, start_);
  end_ = Clock::Instant::max();
}

AxisMotion::State AxisMotion::state_at(Clock::Instant t) const {
  if (t >= end_) return {target_.deg(), 0.0};  // exact, not the sum of the phases
  if (t <= start_) return {start_position_.deg(), start_velocity_};
  const bool stalled = t >= stalled_since_;
  double s = to_seconds(std::min(t, stalled_since_) - start_);
  for (int k = 0; k < phase_count_; ++k) {
    const Phase& phase = phases_[static_cast<std::size_t>(k)];
    if (s <= phase.duration_s)
      return {phase.position_deg + s * (phase.velocity + 0.5 * phase.acceleration * s),
              stalled ? 0.0 : phase.velocity + phase.acceleration * s};
    s -= phase.duration_s;
  }
  return {target_.deg(), 0.0};
}

Angle AxisMotion::position(Clock::Instant t) const {
  return Angle::degrees(state_at(t).position_deg);
}

double AxisMotion::velocity_deg_per_s(Clock::Instant t) const {
  return state_at(t).velocity;
}

}  // namespace abcal::sim
