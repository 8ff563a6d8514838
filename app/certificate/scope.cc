#include "app/certificate/scope.h"

#include <algorithm>
#include <cmath>

namespace abcal {

const std::vector<std::string>& scope_quantities() {
  static const std::vector<std::string> quantities{"sensitivity", "angle", "offset"};
  return quantities;
}

std::optional<double> smallest_uncertainty(const std::vector<ScopeLimit>& scope, const std::string& quantity,
                                           double value, const std::string& unit) {
  std::optional<double> smallest;
  const double size = std::abs(value);
  for (const ScopeLimit& entry : scope) {
    if (entry.quantity != quantity || entry.unit != unit || !(size >= entry.from && size <= entry.to))
      continue;
    const double cmc = entry.relative ? entry.cmc * size : entry.cmc;
    smallest = std::max(smallest.value_or(0.0), cmc);
  }
  return smallest;
}

}  // namespace abcal
