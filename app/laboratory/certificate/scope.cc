#include "app/laboratory/certificate/scope.h"

#include <algorithm>
#include <cmath>
#include <string_view>
#include <utility>

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

/// The unit of the output in a unit of sensitivity, and per which acceleration (m/s2) it is; 0: per none.
std::pair<std::string_view, double> output_and_acceleration(std::string_view unit, double g_loc_mps2) {
  for (const auto& [per, acceleration] :
       {std::pair{std::string_view("/g_loc"), g_loc_mps2}, {"/(m/s2)", 1.0}, {"/g", kStandardGravity}}) {
    if (!unit.ends_with(per)) continue;
    unit.remove_suffix(per.size());
    if (unit.starts_with('(') && unit.ends_with(')')) unit = unit.substr(1, unit.size() - 2);
    return {unit, acceleration};
  }
  return {unit, 0.0};
}

/// Number of units `to` in one unit `from`; absent: of different kinds.
std::optional<double> ratio_of_units(const std::string& from, const std::string& to, double g_loc_mps2) {
  if (from == to) return 1.0;
  const auto [output, per] = output_and_acceleration(from, g_loc_mps2);
  const auto [other_output, other_per] = output_and_acceleration(to, g_loc_mps2);
  if ((per > 0.0) != (other_per > 0.0)) return std::nullopt;
  const auto outputs = unit_ratio(output, other_output);
  if (!outputs || !(per > 0.0)) return outputs;
  return *outputs * other_per / per;
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
