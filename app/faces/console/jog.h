#pragma once

#include <stop_token>

#include "app/faces/console/request.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/run_config.h"

namespace abcal::console {

/// Turns one axis, after homing it if it is not homed. Returns when the controller says that it has stopped.
/// @return where it stopped, by its encoder.
/// @throws InstrumentError, RunInterrupted; the stage is halted then.
Angle turn_axis(const Jog& jog, RotationStage& stage, Clock& clock, const ProtocolConfig& protocol,
                const std::stop_token& stop);

}  // namespace abcal::console
