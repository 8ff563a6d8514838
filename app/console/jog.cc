#include "app/console/jog.h"

#include <fmt/format.h>

#include <cmath>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/experiment_run.h"

namespace abcal::console {
namespace {

/// Waits until the controller says that an axis stands.
void wait_until_stopped(RotationStage& stage, Clock& clock, StageAxis axis, double longest_s,
                        const ProtocolConfig& protocol, const std::stop_token& stop) {
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

Angle turn(RotationStage& stage, Clock& clock, StageAxis axis, Angle by, const ProtocolConfig& protocol,
           const std::stop_token& stop) {
  const auto info = [&] { return stage.identify().axes[index(axis)]; };
  if (!info().referenced) {
    stage.home(axis);
    wait_until_stopped(stage, clock, axis, protocol.homing_timeout_s, protocol, stop);
    if (!info().referenced)
      throw InstrumentError("stage", Fault::kNotReady,
                            fmt::format("axis {} stopped without finding its reference", to_string(axis)));
  }
  const double speed = info().speed_deg_per_s;
  const Angle target = stage.encoder_angle(axis) + by;
  stage.move_to(axis, target);
  const double expected_s = speed > 0.0 ? std::abs(by.deg()) / speed : 0.0;
  wait_until_stopped(stage, clock, axis, expected_s + protocol.motion_timeout_s, protocol, stop);
  const Angle encoder = stage.encoder_angle(axis);
  // Half a degree: a jog is for people, who want to know that it arrived, not how exactly.
  if (!(std::abs((encoder - target).deg()) <= 0.5))
    throw InstrumentError("stage", Fault::kStalled,
                          fmt::format("axis {} stopped at {:.3f} deg, commanded {:.3f} deg", to_string(axis),
                                      encoder.deg(), target.deg()));
  return encoder;
}

}  // namespace

Angle jog(RotationStage& stage, Clock& clock, StageAxis axis, Angle by, const ProtocolConfig& protocol,
          const std::stop_token& stop) {
  try {
    return turn(stage, clock, axis, by, protocol, stop);
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
