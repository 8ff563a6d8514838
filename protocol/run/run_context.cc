#include "protocol/run/run_context.h"

#include <fmt/format.h>

#include "protocol/plan/faces.h"

namespace abcal {

std::string describe(const PlannedAngle& angle) {
  if (angle.experiment == 0)
    return fmt::format("{}X = {:.6g} deg, Z = {:.6g} deg",
                       angle.check ? fmt::format("check pose {}, ", angle.n) : "", angle.x.deg(),
                       angle.z.deg());
  const std::string sweep = angle.sweep > 0 ? fmt::format(", sweep {}", angle.sweep) : "";
  return fmt::format("{}{}, alpha = {} deg", circle_words(angle.experiment, angle.face), sweep,
                     angle.alpha.deg());
}

}  // namespace abcal
