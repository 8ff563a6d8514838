#include "protocol/run/halting.h"

namespace abcal {

HaltOutcome halt_stage(RotationStage& stage) {
  const HaltReport report = stage.halt_axes();
  if (report.all_halted()) return {true, Message("the stage is halted")};
  return {false, Message("the stage did not acknowledge the halt ({axes}): stop it by its own switch",
                         in_words(report))};
}

}  // namespace abcal
