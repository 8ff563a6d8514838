#pragma once

#include <array>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"
#include "drivers/text/message.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// Entry in the list of sources that an uncertainty budget does not cover, where backlash_is_left().
inline constexpr Term kBacklashNotCovered{"backlash of the axes beyond zero_deg (approach_deg = 0)"};

/// Whether an axis turns both up and down on the way through some poses.
/// @param poses  commanded angles of X and Z, in the order in which they are reached
bool turns_both_ways(std::span<const std::array<Angle, 2>> poses);

/// Whether readings of a plan contain the backlash of the axes: angles are not approached from below, and an
/// axis turns both ways.
bool backlash_is_left(const ProtocolConfig& protocol, const std::vector<PlannedAngle>& plan);

/// Consequence of the remaining backlash, in one sentence without its full stop.
/// @param zero  stated uncertainty of the zeros of the axes (zero_deg)
Message backlash_words(Angle zero);

}  // namespace abcal
