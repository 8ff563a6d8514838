#include "protocol/plan/backlash.h"

#include <fmt/format.h>

namespace abcal {

bool turns_both_ways(std::span<const std::array<Angle, 2>> poses) {
  for (std::size_t axis = 0; axis < 2; ++axis) {
    bool up = false, down = false;
    for (std::size_t i = 1; i < poses.size(); ++i) {
      up = up || poses[i - 1][axis] < poses[i][axis];
      down = down || poses[i][axis] < poses[i - 1][axis];
    }
    if (up && down) return true;
  }
  return false;
}

bool backlash_is_left(const ProtocolConfig& protocol, const std::vector<PlannedAngle>& plan) {
  if (protocol.approach > Angle{}) return false;
  std::vector<std::array<Angle, 2>> poses;
  for (const PlannedAngle& angle : plan) poses.push_back({angle.x, angle.z});
  return turns_both_ways(poses);
}

Message backlash_words(Angle zero) {
  return {
      "angles are approached from either side (approach_deg = 0), so that backlash of the axes is not taken "
      "out; required: backlash within zero_deg ({zero:g} degree), or off-diagonal elements are wrong by more "
      "than is stated",
      zero.deg()};
}

}  // namespace abcal
