#pragma once

#include <array>

namespace abcal {

// Names that every result, file, page and message uses, in the order of every result. Every layer may include
// this.
inline constexpr std::array<const char*, 3> kOutputNames{"u", "v", "w"};  ///< Outputs of the accelerometer.
inline constexpr std::array<const char*, 3> kOutputPairs{"uv", "vw",
                                                         "wu"};  ///< In the order of their angles.
/// Axes of the platter at the default orientation, or of the item.
inline constexpr std::array<const char*, 3> kPlatterAxes{"x", "y", "z"};

}  // namespace abcal
