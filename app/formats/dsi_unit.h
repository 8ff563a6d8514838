#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>
#include "drivers/text/message.h"

#include "protocol/plan/response_unit.h"

namespace abcal {

/// A product of powers of units in the notation of D-SI: "\volt\second\tothe{2}\metre\tothe{-1}".
class DsiUnit {
 public:
  DsiUnit() = default;  ///< \one
  explicit DsiUnit(std::string unit) : factors_{{std::move(unit), 1}} {}

  DsiUnit to_the(int power) const;
  DsiUnit operator*(const DsiUnit& other) const;
  std::string text() const;

 private:
  std::vector<std::pair<std::string, int>> factors_;
};

/// How a unit of ours is given in a certificate.
struct UnitInDsi {
  DsiUnit unit;
  double factor = 1.0;  ///< Value in `unit` for 1 of ours; exactly 1 if D-SI has our unit.
  /// Our unit, if D-SI does not have it: then both are given.
  std::optional<DsiUnit> own;
  Message definition;  ///< Definition of our own unit, in words.
  std::string note;    ///< Meaning of the value 1, if the output has no physical unit.
};

/// "V", "g", "LSB", "degree", "%", "mrad"; "V/(m/s2)", "mV/g_n" (standard gravity); "(m/s2)/V"; "urad/K",
/// "ug/K", "ppm/K". A unit that is unknown is a count: \one, with a note.
/// @param g_loc_mps2  "V/g_loc" is a sensitivity, with this local gravity in its definition. Absent: it has
/// the unit of the output, since the quantity is then the change of the output for one g_loc ("g_loc*s_u").
UnitInDsi unit_in_dsi(const std::string& unit, std::optional<double> g_loc_mps2 = {});

/// A unit of D-SI: \volt\second\tothe{2}\metre\tothe{-1} (prefixes before the unit, \tothe{n} after it).
/// @throws std::invalid_argument a unit or a power that is not known, with the text
UnitMeaning meaning_of_d_si(std::string_view text);

}  // namespace abcal
