#include "app/ground/units/typed_unit.h"

#include <array>
#include <utility>

#include "protocol/plan/limits.h"
#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

constexpr std::array<std::pair<std::string_view, PerAcceleration>, 4> kDenominators{
    {{"/(m/s2)", PerAcceleration::kSi},
     {"/g_n", PerAcceleration::kStandard},
     {"/g_loc", PerAcceleration::kLocal},
     {"/g", PerAcceleration::kUnnamed}}};

/// In m/s2; 0: none.
double acceleration_of(PerAcceleration per, double g_loc_mps2) {
  switch (per) {
    case PerAcceleration::kNone:
      return 0.0;
    case PerAcceleration::kSi:
      return 1.0;
    case PerAcceleration::kLocal:
      return g_loc_mps2;
    case PerAcceleration::kStandard:
    case PerAcceleration::kUnnamed:
      break;
  }
  return kStandardGravity;
}

}  // namespace

std::string TypedUnit::name() const {
  if (per == PerAcceleration::kNone) return output;
  std::string text = output.find('/') == std::string::npos ? output : "(" + output + ")";
  for (const auto& [denominator, of] : kDenominators)
    if (of == per) text += denominator;
  return text;
}

TypedUnit typed_unit(std::string_view name) {
  for (const auto& [denominator, per] : kDenominators) {
    if (!name.ends_with(denominator) || name.size() == denominator.size()) continue;
    name.remove_suffix(denominator.size());
    if (name.size() > 2 && name.starts_with('(') && name.ends_with(')'))
      name = name.substr(1, name.size() - 2);
    return {std::string(name), per};
  }
  return {std::string(name), PerAcceleration::kNone};
}

std::vector<TypedUnit> readings_of(const TypedUnit& unit) {
  if (unit.per != PerAcceleration::kUnnamed) return {unit};
  return {{unit.output, PerAcceleration::kStandard}, {unit.output, PerAcceleration::kLocal}};
}

std::optional<double> ratio_of_units(std::string_view from, std::string_view to, double g_loc_mps2) {
  if (from == to) return 1.0;
  const TypedUnit a = typed_unit(from), b = typed_unit(to);
  if ((a.per == PerAcceleration::kNone) != (b.per == PerAcceleration::kNone)) return std::nullopt;
  const auto outputs = unit_ratio(a.output, b.output);
  if (!outputs || a.per == b.per) return outputs;
  return *outputs * acceleration_of(b.per, g_loc_mps2) / acceleration_of(a.per, g_loc_mps2);
}

}  // namespace abcal
