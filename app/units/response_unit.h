#pragma once

#include <map>
#include <string>
#include <string_view>

namespace abcal {

/// What a unit means: a factor to a product of powers of base units. Accelerometers answer in "g", "m/s2",
/// "mV" or counts, certificates in the unit strings of D-SI; results are compared where the products agree.
struct UnitMeaning {
  double factor = 1.0;
  std::map<std::string, int> powers;  ///< "metre": 1, "second": -2; no entry with power 0.

  bool same_kind(const UnitMeaning& other) const { return powers == other.powers; }
  UnitMeaning operator*(const UnitMeaning& other) const;
};

/// An acceleration, m/s2.
UnitMeaning metre_per_second_squared();

/// A response unit as accelerometers and bench files name it: V, A and their prefixes, "g" = 9.80665 m/s2,
/// "mg", "m/s2". Anything else ("LSB", "R") is a unit of its own, with that name as its base; count, counts,
/// digit and digits are "LSB".
UnitMeaning meaning_of_response_unit(std::string_view name);

/// A unit of D-SI: \volt\second\tothe{2}\metre\tothe{-1} (prefixes before the unit, \tothe{n} after it).
/// @throws std::invalid_argument a unit or a power that is not known, with the text
UnitMeaning meaning_of_d_si(std::string_view text);

/// A short name of a response unit with this meaning: "V", "m/s2", "1", or the product written out.
std::string name_of(const UnitMeaning& unit);

}  // namespace abcal
