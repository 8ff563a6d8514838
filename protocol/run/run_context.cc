#include "protocol/run/run_context.h"

#include <fmt/format.h>

namespace abcal {

std::string describe(const PlannedAngle& angle) {
  return fmt::format("experiment {}, alpha = {} deg", angle.experiment, angle.alpha.deg());
}

}  // namespace abcal
