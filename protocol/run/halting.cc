#include "protocol/run/halting.h"

#include <fmt/format.h>

namespace abcal {

HaltOutcome halt_stage(RotationStage& stage) {
  const HaltReport report = stage.halt_axes();
  if (report.all_halted()) return {true, "the stage is halted"};
  return {false, fmt::format("the stage did not acknowledge the halt ({}): stop it by its own switch",
                             in_words(report))};
}

}  // namespace abcal
