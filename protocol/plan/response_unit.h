#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <string_view>

namespace abcal {

/// Meaning of a unit: a factor and a product of powers of base units. Accelerometers answer in "g", "m/s2",
/// "mV" or counts; certificates contain the unit strings of D-SI. Results are compared if the products agree.
struct UnitMeaning {
  double factor = 1.0;
  std::map<std::string, int> powers;  ///< "metre": 1, "second": -2; no entry with power 0.

  bool same_kind(const UnitMeaning& other) const { return powers == other.powers; }
  UnitMeaning operator*(const UnitMeaning& other) const;
};

/// An acceleration, m/s2.
UnitMeaning metre_per_second_squared();

/// A prefix: as letters of a unit's name ("m") and as a word of D-SI ("milli").
struct UnitPrefix {
  std::string_view letters, d_si;
  double factor;
};

/// One row of the table of units.
struct NamedUnit {
  std::string_view name;  ///< "V"; empty: known to D-SI only.
  std::string_view d_si;  ///< Word of D-SI, "volt"; empty: D-SI has none (g).
  double factor = 1.0;    ///< To the base units.
  struct Power {
    std::string_view base;
    int exponent = 0;
  };
  std::array<Power, 2> powers{};  ///< Powers of base units.
  bool takes_prefix = false;      ///< May carry a prefix: "mV", "ug".

  UnitMeaning meaning() const;
};

/// A unit of the table with its prefix.
struct PrefixedUnit {
  const UnitPrefix* prefix = nullptr;  ///< Null: none.
  const NamedUnit* unit = nullptr;

  double prefix_factor() const { return prefix == nullptr ? 1.0 : prefix->factor; }
};

/// "V", "mV", "ug", "m/s^2" in the table of units; absent: not in it.
std::optional<PrefixedUnit> find_unit(std::string_view name);

/// The row with this word of D-SI ("volt"), without backslash; null if absent.
const NamedUnit* find_d_si_unit(std::string_view word);

/// The prefix with this word of D-SI ("milli"), without backslash; null if absent.
const UnitPrefix* find_d_si_prefix(std::string_view word);

/// A response unit as accelerometers and bench files name it: V, A and their prefixes, "g" = 9.80665 m/s2,
/// "mg", "m/s2". Anything else ("LSB", "R") is a unit of its own, with that name as its base; count, counts,
/// digit and digits are "LSB".
UnitMeaning meaning_of_response_unit(std::string_view name);

/// The number of units `to` in one unit `from`: 1000 from "V" to "mV"; absent: of different kinds.
std::optional<double> unit_ratio(std::string_view from, std::string_view to);

/// The value of one unit of acceleration in m/s2: 9.80665 for "g", 1 for "m/s2"; absent: no acceleration.
std::optional<double> acceleration_unit_mps2(std::string_view name);

/// A short name of a response unit with this meaning: "V", "m/s2", "1", or the product written out.
std::string name_of(const UnitMeaning& unit);

}  // namespace abcal
