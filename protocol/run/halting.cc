#include "protocol/run/halting.h"

namespace abcal {

HaltOutcome halt_stage(RotationStage& stage) {
  if (stage.halt()) return {true, "the stage is halted"};
  return {false, "the stage did not acknowledge the halt: stop it by its own switch"};
}

}  // namespace abcal
