#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// The acceleration that the unit of a sensitivity refers to. Local and standard gravity differ by up to 0.3
/// %.
enum class PerAcceleration {
  kNone,      ///< No sensitivity: "V", "degree".
  kSi,        ///< "V/(m/s2)"
  kStandard,  ///< "V/g_n": 9.80665 m/s2, exact.
  kLocal,     ///< "V/g_loc": a value with its own uncertainty.
  kUnnamed,   ///< "V/g": one of the two, but not which.
};

/// A unit with its kind: the unit of the output, and the acceleration it is per.
struct TypedUnit {
  std::string output;  ///< "mV"
  PerAcceleration per = PerAcceleration::kNone;

  /// "mV/g_n", "(V/V)/g_loc".
  std::string name() const;
};

TypedUnit typed_unit(std::string_view name);

/// The units that a unit may mean: two for a sensitivity per "g", else itself.
std::vector<TypedUnit> readings_of(const TypedUnit& unit);

/// The number of units `to` in one unit `from`. A gravity without a name counts as standard gravity. Absent:
/// of different kinds. @param g_loc_mps2  local gravity, for units per g_loc
std::optional<double> ratio_of_units(std::string_view from, std::string_view to, double g_loc_mps2);

}  // namespace abcal
