#include "app/faces/console/jog.h"

#include <fmt/format.h>

#include <cmath>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/experiment_run.h"

namespace abcal::console {
namespace {

/// The stage, and how long its motions may take.
struct JoggedStage {
  RotationStage& stage;
  Clock& clock;
  const ProtocolConfig& protocol;
  const std::stop_token& stop;

  StageAxisInfo info(StageAxis axis) const { return stage.identify().axes[index(axis)]; }
  void wait_until_stopped(StageAxis axis, double longest_s) const;
  void home_if_needed(StageAxis axis) const;
  Angle turn(const Jog& jog) const;
};

void JoggedStage::wait_until_stopped(StageAxis axis, double longest_s) const {
  const Clock::Instant deadline = clock.now() + from_seconds(longest_s);
  while (stage.motion_state(axis) == MotionState::kMoving) {
    if (stop.stop_requested()) throw RunInterrupted("stopped by the operator");
    if (clock.now() > deadline)
      throw InstrumentError("stage", Fault::kStalled,
                            fmt::format("axis {} still moves after {:.0f} s", to_string(axis), longest_s));
    clock.sleep_until(clock.now() + from_seconds(protocol.poll_interval_s));
  }
  if (stop.stop_requested()) throw RunInterrupted("stopped by the operator");
}

void JoggedStage::home_if_needed(StageAxis axis) const {
  if (info(axis).referenced) return;
  stage.home(axis);
  wait_until_stopped(axis, protocol.homing_timeout_s);
  if (!info(axis).referenced)
    throw InstrumentError("stage", Fault::kNotReady,
                          fmt::format("axis {} stopped without finding its reference", to_string(axis)));
}

Angle JoggedStage::turn(const Jog& jog) const {
  home_if_needed(jog.axis);
  const double speed = info(jog.axis).speed_deg_per_s;
  const Angle target = stage.encoder_angle(jog.axis) + jog.by;
  stage.move_to(jog.axis, target);
  const double expected_s = speed > 0.0 ? std::abs(jog.by.deg()) / speed : 0.0;
  wait_until_stopped(jog.axis, expected_s + protocol.motion_timeout_s);
  const Angle encoder = stage.encoder_angle(jog.axis);
  // Half a degree: a jog only needs to arrive; its accuracy does not matter.
  if (!(std::abs((encoder - target).deg()) <= 0.5))
    throw InstrumentError("stage", Fault::kStalled,
                          fmt::format("axis {} stopped at {:.3f} deg, commanded {:.3f} deg",
                                      to_string(jog.axis), encoder.deg(), target.deg()));
  return encoder;
}

}  // namespace

Angle turn_axis(const Jog& jog, RotationStage& stage, Clock& clock, const ProtocolConfig& protocol,
                const std::stop_token& stop) {
  try {
    return JoggedStage{stage, clock, protocol, stop}.turn(jog);
  } catch (const InstrumentError& error) {
    const bool halted = stage.halt();
    // A halt from another thread makes the exchange under way fail: that is the operator's stop, not a fault.
    if (stop.stop_requested())
      throw RunInterrupted(halted
                               ? "stopped by the operator"
                               : "stopped by the operator; the stage did not acknowledge the halt: stop it "
                                 "by its own switch");
    throw;
  } catch (...) {
    stage.halt();
    throw;
  }
}

}  // namespace abcal::console
