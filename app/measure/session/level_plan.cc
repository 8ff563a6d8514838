#include "app/measure/session/level_plan.h"

#include <utility>

namespace abcal {

std::vector<PlannedAngle> level_plan(const ProtocolConfig& protocol,
                                     const std::array<AxisTravel, 2>& travel) {
  std::vector<PlannedAngle> plan;
  ProtocolConfig one_face = protocol;
  one_face.faces = 1;
  for (const PlannedAngle& angle : make_rotation_plan(one_face, travel)) {
    // Experiment 3 turns Z through the same angles, with X at -90 degrees instead of 0.
    if (angle.experiment == 3 && !angle.closing)
      plan.push_back({0, angle.n, false, angle.alpha, Angle{}, angle.z});
  }
  constexpr std::array<std::pair<double, double>, kReversalPositions> kPositions{
      {{0.0, 0.0}, {0.0, 180.0}, {180.0, 180.0}, {180.0, 0.0}}};
  int n = protocol.steps;
  for (const auto& [x, z] : kPositions) {
    plan.push_back({0, ++n, false, Angle{}, Angle::degrees(x), Angle::degrees(z)});
  }
  return plan;
}

}  // namespace abcal
