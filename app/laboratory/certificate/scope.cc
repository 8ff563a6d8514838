#include "app/laboratory/certificate/scope.h"

#include <algorithm>
#include <cmath>

#include "app/formats/typed_unit.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

/// A value that a scope may limit: a sensitivity, angle or offset.
struct Scoped {
  std::string quantity;
  double value = 0.0;
  std::string unit;
  double factor = 1.0;  ///< Number of the quantity's own units in one of `unit`.
};

std::optional<Scoped> scoped(const CalibrationResult& result, const std::string& name,
                             const Quantity& quantity) {
  const auto plain = [&](const char* what) { return Scoped{what, quantity.value, quantity.unit, 1.0}; };
  if (name.starts_with("sensitivity_") || name.starts_with("intrinsic_sensitivity_"))
    return plain("sensitivity");
  if (name.starts_with("intrinsic_angle_")) return plain("angle");
  if (name.starts_with("offset_")) return plain("offset");
  if (name.starts_with("non_orthogonality_")) {  // The angle without its 90 degrees.
    Scoped angle = plain("angle");
    angle.value += 90.0 * unit_ratio("degree", quantity.unit).value_or(0.0);
    return angle;
  }
  if (name.starts_with("bias_")) {  // The offset, in mg.
    const auto axis = static_cast<std::size_t>(name.back() - 'u');
    const double per_g_loc = result.intrinsic_sensitivity.at(axis).value;
    return Scoped{"offset", result.offset.at(axis).value, result.offset.at(axis).unit,
                  1e3 * result.g_loc.value / (kStandardGravity * per_g_loc)};
  }
  return std::nullopt;
}

}  // namespace

const std::vector<std::string>& scope_quantities() {
  static const std::vector<std::string> quantities{"sensitivity", "angle", "offset"};
  return quantities;
}

std::optional<double> smallest_uncertainty(const std::vector<ScopeLimit>& scope,
                                           const CalibrationResult& result, const std::string& name,
                                           const Quantity& quantity) {
  std::optional<double> smallest;
  const auto of = scoped(result, name, quantity);
  if (!of) return smallest;
  for (const ScopeLimit& entry : scope) {
    if (entry.quantity != of->quantity) continue;
    const auto factor = ratio_of_units(of->unit, entry.unit, result.g_loc.value);
    if (!factor) continue;
    const double size = std::abs(of->value * *factor);
    if (!(size >= entry.from && size <= entry.to)) continue;
    const double cmc = entry.relative ? entry.cmc * size : entry.cmc;
    smallest = std::max(smallest.value_or(0.0), std::abs(cmc / *factor * of->factor));
  }
  return smallest;
}

}  // namespace abcal
