#pragma once

#include <stop_token>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/run_config.h"

namespace abcal::console {

/// Turns one axis by an angle from where its encoder says it is, after searching its reference if it has
/// none. Returns when the controller says it stands there.
/// @return where it stands, by its encoder.
/// @throws InstrumentError, RunInterrupted; the stage is halted then.
Angle jog(RotationStage& stage, Clock& clock, StageAxis axis, Angle by, const ProtocolConfig& protocol,
          const std::stop_token& stop);

}  // namespace abcal::console
