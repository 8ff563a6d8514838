#pragma once

#include "drivers/instrument/rotation_stage.h"
#include "drivers/text/message.h"

namespace abcal {

/// The outcome of a halt.
struct HaltOutcome {
  bool acknowledged = false;  ///< By every axis.
  /// "the stage is halted"; or which axis may still be moving, and what to do.
  Message words;
};

/// Halts all axes, also if one of them cannot be reached.
HaltOutcome halt_stage(RotationStage& stage);

}  // namespace abcal
