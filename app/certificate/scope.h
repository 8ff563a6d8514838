#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace abcal {

/// The smallest expanded uncertainty (k = 2) that a laboratory is accredited for, or claims, in a range: its
/// calibration and measurement capability (CMC).
struct ScopeLimit {
  std::string quantity;  ///< "sensitivity", "angle", "offset"
  std::string unit;      ///< As in a result: "V/g_loc".
  double from = 0.0, to = 0.0;
  double cmc = 0.0;  ///< In `unit`, or a part of the value.
  bool relative = false;
  std::uint32_t line = 0;  ///< In the laboratory file; 0: from the register.
};

/// What `quantity` may be.
const std::vector<std::string>& scope_quantities();

/// The smallest expanded uncertainty that may be stated for a value, in its unit: of several that cover its
/// size the largest. Nothing: the scope has none.
std::optional<double> smallest_uncertainty(const std::vector<ScopeLimit>& scope, const std::string& quantity,
                                           double value, const std::string& unit);

}  // namespace abcal
