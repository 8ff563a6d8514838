#include "protocol/run/motion.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

/// An axis that the controller calls stopped may still creep into the window; after this it will not.
constexpr double kStoppedOutsideWindowS = 1.0;
/// During a sweep the state of the motion is asked for with each of this many angles, and with each when the
/// end is nearer than this time at the rate.
constexpr std::size_t kStateEvery = 8;
constexpr double kNearEndS = 0.2;

}  // namespace

void Motion::home(StageAxis axis) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  stage_.home(axis);
  const Clock::Instant deadline = context_.clock.now() + from_seconds(protocol.homing_timeout_s);
  while (stage_.motion_state(axis) == MotionState::kMoving) {
    if (context_.clock.now() > deadline) {
      throw InstrumentError(
          context_.stage_name(), Fault::kStalled,
          Message("axis {axis} is still searching for its reference after {seconds} s (homing_timeout_s)",
                  to_string(axis), protocol.homing_timeout_s));
    }
    context_.clock.wait_until(context_.clock.now() + from_seconds(protocol.poll_interval_s));
  }
  context_.stage_info = stage_.identify();
  if (!context_.stage_info.axes[index(axis)].referenced) {
    throw InstrumentError(context_.stage_name(), Fault::kNotReady,
                          Message("axis {axis} stopped without finding its reference", to_string(axis)));
  }
}

std::optional<Clock::Instant> Motion::move_to(StageAxis axis, Angle target) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  std::optional<Angle>& known = known_[index(axis)];
  if (known && *known == target) return std::nullopt;
  if (!known) known = stage_.encoder_angle(axis);
  if (protocol.approach > Angle{} && target < *known + protocol.position_window) {
    const Angle below = target - protocol.approach;
    carry_out({axis, below, std::max(protocol.position_window, protocol.approach * 0.5), 1});
  }
  known.reset();  // Until it has arrived, nothing is known.
  const Clock::Instant stopped = carry_out({axis, target, protocol.position_window, protocol.window_polls});
  known = target;
  return stopped;
}

std::vector<AngleSample> Motion::sweep(StageAxis axis, Angle target, double rate_deg_per_s,
                                       const std::function<void()>& look) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  known_[index(axis)].reset();
  const double way = std::abs((target - stage_.encoder_angle(axis)).deg());
  if (const Angle longest = context_.stage_info.axes[index(axis)].longest_move;
      longest > Angle{} && way > longest.deg()) {
    throw InstrumentError(
        context_.stage_name(), Fault::kRefused,
        Message("axis {axis} counts modulo 360 (wraps_deg): it can be moved by {longest} deg at most, and "
                "not by a whole turn at a constant rate; required: motion = \"steps\"",
                to_string(axis), longest.deg()));
  }
  const double expected_s = way / rate_deg_per_s + rate_deg_per_s / protocol.acceleration_deg_per_s2;
  stage_.set_speed(axis, rate_deg_per_s);
  stage_.move_to(axis, target);
  const Clock::Instant begin = context_.clock.now();
  const Clock::Instant deadline = begin + from_seconds(expected_s + protocol.motion_timeout_s);
  const Move move{axis, target, protocol.position_window, protocol.window_polls};
  std::vector<AngleSample> samples;
  while (true) {
    const Clock::Instant asked = context_.clock.now();
    const double angle_deg = stage_.encoder_angle(axis).deg();
    const Clock::Instant told = context_.clock.now();
    samples.push_back({asked + (told - asked) / 2, angle_deg});
    look();
    // The state is asked for rarely: each question costs samples.
    const bool near_end = std::abs(angle_deg - target.deg()) < kNearEndS * rate_deg_per_s;
    if ((near_end || samples.size() % kStateEvery == 0) && stage_.motion_state(axis) == MotionState::kStopped)
      break;
    if (told > deadline) fail_still_moving(move, to_seconds(told - begin), expected_s);
    context_.clock.wait_until(told + from_seconds(protocol.poll_interval_s));
  }
  wait_for_arrival(move, 0.0);
  look();
  stage_.set_speed(axis, std::nullopt);
  known_[index(axis)] = target;
  return samples;
}

/// @return when the axis was first found stopped inside the window.
Clock::Instant Motion::carry_out(const Move& move) {
  Angle from = stage_.encoder_angle(move.axis);
  const Angle longest = context_.stage_info.axes[index(move.axis)].longest_move;
  if (const double way = (move.target - from).deg(); longest > Angle{} && std::abs(way) > longest.deg()) {
    const double pieces = std::ceil(std::abs(way) / longest.deg());
    for (double done = 1.0; done < pieces; ++done)
      carry_out({move.axis, from + Angle::degrees(way * done / pieces), move.window, 1});
    from = stage_.encoder_angle(move.axis);
  }
  const double speed = context_.stage_info.axes[index(move.axis)].speed_deg_per_s;
  const double expected_s = speed > 0.0 ? std::abs((move.target - from).deg()) / speed : 0.0;
  stage_.move_to(move.axis, move.target);
  return wait_for_arrival(move, expected_s);
}

Clock::Instant Motion::wait_for_arrival(const Move& move, double expected_s) {
  const ProtocolConfig& protocol = context_.settings.protocol;
  // From here on, and not from the command: a person who turns the stage by hand takes as long as it takes.
  const Clock::Instant begin = context_.clock.now();
  const Clock::Instant deadline = begin + from_seconds(expected_s + protocol.motion_timeout_s);
  int polls_inside = 0;
  std::optional<Clock::Instant> stopped_inside;
  std::optional<Clock::Instant> stopped_outside;
  while (true) {
    const bool stopped = stage_.motion_state(move.axis) == MotionState::kStopped;
    const Clock::Instant now = context_.clock.now();
    if (!stopped) {
      polls_inside = 0;
      stopped_inside.reset();
      stopped_outside.reset();
    } else {
      const Angle encoder = stage_.encoder_angle(move.axis);
      // Written so that an encoder angle that is not a number is outside.
      if (std::abs((encoder - move.target).deg()) <= move.window.deg()) {
        if (!stopped_inside) stopped_inside = now;
        stopped_outside.reset();
        if (++polls_inside >= move.polls) return *stopped_inside;
      } else {
        polls_inside = 0;
        stopped_inside.reset();
        if (!stopped_outside) stopped_outside = now;
        if (to_seconds(now - *stopped_outside) > kStoppedOutsideWindowS) fail_outside_window(move, encoder);
      }
    }
    // An axis at rest at its target has arrived in time, even if slow replies delayed the polls.
    if (now > deadline && !stopped_inside) fail_still_moving(move, to_seconds(now - begin), expected_s);
    context_.clock.wait_until(now + from_seconds(protocol.poll_interval_s));
  }
}

void Motion::fail_outside_window(const Move& move, Angle encoder) const {
  const double turns = std::round((encoder - move.target).deg() / 360.0);
  if (turns != 0.0 && std::abs((encoder - move.target).deg() - 360.0 * turns) <= move.window.deg()) {
    throw InstrumentError(
        context_.stage_name(), Fault::kStalled,
        Message("axis {axis} reports {found:.5f} deg, commanded {commanded:.5f} deg: the difference is a "
                "number of whole turns. If the controller counts modulo 360, state wraps_deg = 360 under "
                "[stage.{name}] of the bench file; otherwise home the axis",
                to_string(move.axis), encoder.deg(), move.target.deg(),
                move.axis == StageAxis::kX ? "x" : "z"));
  }
  throw InstrumentError(
      context_.stage_name(), Fault::kStalled,
      Message(
          "axis {axis} stopped at {found:.5f} deg, commanded {commanded:.5f} deg; required: within {window} "
          "deg (position_window_deg). Check for a missed step, a limit switch or a cable that pulls",
          to_string(move.axis), encoder.deg(), move.target.deg(), move.window.deg()));
}

void Motion::fail_still_moving(const Move& move, double elapsed_s, double expected_s) {
  throw InstrumentError(
      context_.stage_name(), Fault::kStalled,
      Message(
          "axis {axis} is still moving {elapsed:.1f} s after the command to {commanded:.5f} deg, encoder at "
          "{encoder:.5f} deg (motion_timeout_s = {timeout} beyond the {expected:.1f} s the move needs)",
          to_string(move.axis), elapsed_s, move.target.deg(), stage_.encoder_angle(move.axis).deg(),
          context_.settings.protocol.motion_timeout_s, expected_s));
}

bool Motion::is_inside_window(const PlannedAngle& angle, Angle encoder_x, Angle encoder_z) const {
  const double window = context_.settings.protocol.position_window.deg();
  return std::abs((encoder_x - angle.x).deg()) <= window && std::abs((encoder_z - angle.z).deg()) <= window;
}

bool Motion::is_inside_window(const PlannedAngle& angle) {
  const Angle z = stage_.encoder_angle(StageAxis::kZ);  // Z first: the order of all recordings so far.
  return is_inside_window(angle, stage_.encoder_angle(StageAxis::kX), z);
}

}  // namespace abcal
