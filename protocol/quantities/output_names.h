#pragma once

#include <array>
#include <cstddef>
#include <string_view>

#include "drivers/text/letters.h"

namespace abcal {

/// Symbols of the 18 outputs of a calibration: s row by row, O, intrinsic s, phi. The first twelve are the
/// rows of a Covariance12.
inline constexpr std::array<std::string_view, 18> kOutputSymbols{
    "s_ux", "s_uy", "s_uz", "s_vx", "s_vy", "s_vz", "s_wx",   "s_wy",   "s_wz",
    "O_u",  "O_v",  "O_w",  "s_u",  "s_v",  "s_w",  "phi_uv", "phi_vw", "phi_wu"};

/// How many of them are elements of the matrix, and depend on the mounting; all others do not.
inline constexpr std::size_t kOfMatrix = 9;

/// Symbols of the nine outputs that do not depend on the mounting: intrinsic s, phi, O, the rows of a
/// Covariance9.
inline constexpr std::array<std::string_view, 9> kIntrinsicSymbols = [] {
  std::array<std::string_view, 9> symbols;
  for (std::size_t i = 0; i < symbols.size(); ++i) symbols[i] = kOutputSymbols[i < 6 ? 12 + i : 3 + i];
  return symbols;
}();

}  // namespace abcal
