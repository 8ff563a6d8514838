#include "app/formats/typed_unit.h"

#include "drivers/text/names.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/response_unit.h"

namespace abcal {
namespace {

constexpr auto kDenominators = names<PerAcceleration>({{PerAcceleration::kSi, "/(m/s2)"},
                                                       {PerAcceleration::kStandard, "/g_n"},
                                                       {PerAcceleration::kLocal, "/g_loc"},
                                                       {PerAcceleration::kUnnamed, "/g"}});

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
  text += kDenominators.of(per);
  return text;
}

TypedUnit typed_unit(std::string_view name) {
  for (const auto& [per, denominator] : kDenominators.rows) {
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
