#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "drivers/text/message.h"

namespace abcal {

/// Numbers of mountings for which mounting_turns() has a series.
inline constexpr std::array<int, 4> kMountingCounts{2, 3, 6, 12};

/// How the item of a series (docs/theory/series.md) is turned in each of its mountings, relative to the
/// first: right-handed turns in the frame of the platter, by which a vector v of the item becomes turn * v.
/// The first is the identity. 2: and 90 degrees about X. 3: the axes exchanged in turn. 6: these three, each
/// also with half a turn about z after it. 12: these three, each also with half a turn about x, y and z after
/// it.
/// @throws std::invalid_argument another count
std::vector<Eigen::Matrix3d> mounting_turns(int count);

/// The 24 turns of a cube.
const std::vector<Eigen::Matrix3d>& turns_of_cube();

/// The orientation of an item after one of the turns of a cube: "turned by 90 degrees about X", "turned by
/// 120 degrees about X-Y+Z"; without a turn "as in the first run".
Message turn_in_words(const Eigen::Matrix3d& turn);

/// Directions of u, v, w, as rows, as [item] mounting states them: "x -z y". Nullopt if one of them is not
/// along an axis. The inverse of mounting_matrix() (protocol/plan/limits.h).
std::optional<std::string> mounting_words(const Eigen::Matrix3d& directions);

}  // namespace abcal
