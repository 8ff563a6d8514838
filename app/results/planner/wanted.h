#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace abcal {

/// Targets of a plan: the largest standard uncertainty of each group of outputs.
enum class PlannedOutput : std::size_t {
  kSensitivity,  ///< "s": diagonal of the sensitivity matrix, relative to S (1)
  kOffDiagonal,  ///< "off": its other elements, relative to S (1)
  kOffset,       ///< "O": relative to S, that is in units of g_loc
  kAngle,        ///< "phi": intrinsic angles (degree)
};
inline constexpr std::size_t kPlannedOutputs = 4;

/// One number for each PlannedOutput.
using PlannedValues = std::array<double, kPlannedOutputs>;
/// The wanted values; absent: any.
using WantedValues = std::array<std::optional<double>, kPlannedOutputs>;

/// "s", "off", "O", "phi".
std::string_view symbol_of(PlannedOutput output);
/// "degree" for phi; empty for the others, which are relative to S.
std::string_view unit_of(PlannedOutput output);

/// The standard uncertainties of the paper's type B (Geist & Gaitan, table 8): s 1e-5, off 2e-4, O 5e-5,
/// phi 5e-3 degrees.
WantedValues published_wanted();

/// Reads "phi=1e-3 deg, s=2e-5, O=5e-5". Each value is a standard uncertainty above 0; phi with its unit
/// (deg), the others without one or with "g" (O) or "ppm".
/// @throws std::invalid_argument with all problems of the text
WantedValues parse_wanted(std::string_view text);

}  // namespace abcal
