#include "app/console/jog.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/experiment_run.h"

namespace abcal::console {
namespace {

/// The stage, and how long its motions may take.
struct JoggedStage {
  RotationStage& stage;
  Clock& clock;
  const ProtocolConfig& protocol;
  const JogEnd& end;

  StageAxisInfo info(StageAxis axis) const { return stage.identify().axes[index(axis)]; }
  void wait_until_stopped(StageAxis axis, double longest_s) const;
  void home_if_needed(StageAxis axis) const;
  void go(StageAxis axis, Angle from, Angle target) const;
  Angle turn(const Jog& jog) const;
  Angle turn_while_held(const Jog& jog) const;
};

/// The button was released while the axis turned.
struct LetGo {};

void JoggedStage::wait_until_stopped(StageAxis axis, double longest_s) const {
  const Clock::Instant deadline = clock.now() + from_seconds(longest_s);
  while (stage.motion_state(axis) == MotionState::kMoving) {
    if (end.stop.stop_requested()) throw RunInterrupted(Message("stopped by the operator"));
    if (end.let_go.stop_requested()) throw LetGo();
    if (clock.now() > deadline)
      throw InstrumentError(
          "stage", Fault::kStalled,
          Message("axis {axis} still moves after {seconds:.0f} s", to_string(axis), longest_s));
    clock.sleep_until(clock.now() + from_seconds(protocol.poll_interval_s));
  }
  if (end.stop.stop_requested()) throw RunInterrupted(Message("stopped by the operator"));
}

void JoggedStage::home_if_needed(StageAxis axis) const {
  if (info(axis).referenced) return;
  stage.home(axis);
  wait_until_stopped(axis, protocol.homing_timeout_s);
  if (!info(axis).referenced)
    throw InstrumentError("stage", Fault::kNotReady,
                          Message("axis {axis} stopped without finding its reference", to_string(axis)));
}

/// Moves an axis, and waits for as long as the way takes at its speed and the timeout beyond.
void JoggedStage::go(StageAxis axis, Angle from, Angle target) const {
  const double speed = info(axis).speed_deg_per_s;
  stage.move_to(axis, target);
  const double expected_s = speed > 0.0 ? std::abs((target - from).deg()) / speed : 0.0;
  wait_until_stopped(axis, expected_s + protocol.motion_timeout_s);
}

/// Turns towards the end of the travel until the button is released; then halts the axis, and asks its
/// controller until it reports that the axis has stopped.
Angle JoggedStage::turn_while_held(const Jog& jog) const {
  const StageAxisInfo axis = info(jog.axis);
  if (!axis.referenced)
    throw Telling<std::invalid_argument>(
        Message("axis {axis} is not homed: turn it by an angle first, which homes it", to_string(jog.axis)));
  const Angle from = stage.encoder_angle(jog.axis);
  const double target_deg =
      std::clamp((from + jog.angle).deg(), axis.travel_min.deg(), axis.travel_max.deg());
  try {
    if (end.let_go.stop_requested()) throw LetGo();
    go(jog.axis, from, Angle::degrees(target_deg));
  } catch (const InstrumentError&) {
    // The halt from the watcher's thread makes an exchange under way fail.
    if (!end.let_go.stop_requested() || end.stop.stop_requested()) throw;
  } catch (const LetGo&) {
  }
  if (end.let_go.stop_requested()) {
    if (!stage.halt())
      throw InstrumentError("stage", Fault::kNoReply,
                            Message("the button was let go, and the stage did not acknowledge the halt: stop "
                                    "it by its own switch"));
    const JogEnd halted{end.stop};
    JoggedStage{stage, clock, protocol, halted}.wait_until_stopped(jog.axis, protocol.motion_timeout_s);
  }
  return stage.encoder_angle(jog.axis);
}

Angle JoggedStage::turn(const Jog& jog) const {
  if (jog.how == Jog::How::kWhileHeld) return turn_while_held(jog);
  home_if_needed(jog.axis);
  const Angle from = stage.encoder_angle(jog.axis);
  const Angle target = jog.how == Jog::How::kTo ? jog.angle : from + jog.angle;
  go(jog.axis, from, target);
  const Angle encoder = stage.encoder_angle(jog.axis);
  // Half a degree: a jog only needs to arrive; its accuracy does not matter.
  if (!(std::abs((encoder - target).deg()) <= 0.5))
    throw InstrumentError("stage", Fault::kStalled,
                          Message("axis {axis} stopped at {found:.3f} deg, commanded {commanded:.3f} deg",
                                  to_string(jog.axis), encoder.deg(), target.deg()));
  return encoder;
}

}  // namespace

HeldButton::HeldButton() : watcher_([this](const std::stop_token& end) { watch(end); }) {}

void HeldButton::hear(const KeepTurning& sign) {
  const std::lock_guard lock(mutex_);
  last_ = std::chrono::steady_clock::now();
  is_released_ = is_released_ || sign.let_go;
  heard_.notify_all();
}

void HeldButton::watch(const std::stop_token& end) {
  std::unique_lock lock(mutex_);
  while (!end.stop_requested() && !is_released_ && std::chrono::steady_clock::now() < last_ + kLongestSilence)
    heard_.wait_until(lock, end, last_ + kLongestSilence, [&] { return is_released_; });
  lock.unlock();
  if (!end.stop_requested()) source_.request_stop();
}

Angle turn_axis(const Jog& jog, RotationStage& stage, Clock& clock, const ProtocolConfig& protocol,
                const JogEnd& end) {
  try {
    return JoggedStage{stage, clock, protocol, end}.turn(jog);
  } catch (const InstrumentError& error) {
    const bool halted = stage.halt();
    // A halt from another thread makes the exchange under way fail: that is the operator's stop, not a fault.
    if (end.stop.stop_requested())
      throw RunInterrupted(halted ? Message("stopped by the operator")
                                  : Message("stopped by the operator; the stage did not acknowledge the "
                                            "halt: stop it by its own switch"));
    throw;
  } catch (...) {
    stage.halt();
    throw;
  }
}

}  // namespace abcal::console
