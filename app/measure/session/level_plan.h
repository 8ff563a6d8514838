#pragma once

#include <array>
#include <vector>

#include "protocol/plan/rotation_plan.h"

namespace abcal {

/// Number of reversal positions at the end of a level_plan().
constexpr std::size_t kReversalPositions = 4;

/// The angles of `abcal level`: appendix A's spin about Z at Theta_X = 0, then the four positions that free
/// the zero of X (protocol/estimators/circle/level_estimator.h).
std::vector<PlannedAngle> level_plan(const ProtocolConfig& protocol, const std::array<AxisTravel, 2>& travel);

}  // namespace abcal
