#pragma once

#include <string>
#include <string_view>

#include "drivers/instrument/angle.h"

namespace abcal {

/// Formulas of normal gravity (docs/theory/gravity.md).
enum class GravityFormula {
  kGrs80,   ///< Somigliana on the ellipsoid of the Geodetic Reference System 1980.
  kWgs84,   ///< Somigliana on the ellipsoid of WGS 84.
  kWelmec,  ///< WELMEC guide 2 (weighing instruments), height term linear.
  kNpl,     ///< NPL and BGS, the same series with its own constants.
};

/// "GRS80", "WGS84", "WELMEC", "NPL".
std::string_view to_string(GravityFormula formula);

/// Gravity from a formula alone, to be replaced by a survey.
struct FormulaGravity {
  double value_mps2 = 0.0;
  double standard_uncertainty_mps2 = 0.0;  ///< Rectangular +-5e-5 of the value: half width / sqrt(3).
  double half_width_mps2 = 0.0;            ///< 5e-5 of the value.
  std::string source;                      ///< Provenance: formula, latitude, height.
  std::string warning;  ///< Limits of validity that a person must know before using the value.
};

/// Normal gravity at a geodetic latitude and a height above the ellipsoid (in practice above sea level), m.
/// @throws std::invalid_argument latitude outside +-90 degrees, height outside -500 m .. 9000 m (habitable
///         ground; the series in height is of second order), or not finite; the message names both if both
///         are
FormulaGravity formula_gravity(Angle latitude, double height_m,
                               GravityFormula formula = GravityFormula::kGrs80);

}  // namespace abcal
