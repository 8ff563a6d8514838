#include "protocol/gravity/local_gravity.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <stdexcept>
#include <vector>

#include "drivers/text/names.h"

namespace abcal {

namespace {

/// A reference ellipsoid with its normal gravity (docs/theory/gravity.md).
struct Ellipsoid {
  double semi_major_m;  // a
  double flattening;    // f
  double equator_mps2;  // ge
  double pole_mps2;     // gp
  double e2;            // first eccentricity squared
  double m;             // w^2 a^2 b / GM
};

constexpr Ellipsoid kGrs80Ellipsoid{6378137.0,    1.0 / 298.257222101, 9.7803267715,
                                    9.8321863685, 0.00669438002290,    0.00344978600308};
constexpr Ellipsoid kWgs84Ellipsoid{6378137.0,    1.0 / 298.257223563, 9.7803253359,
                                    9.8321849379, 0.00669437999014,    0.00344978650684};

// Local masses move gravity away from every formula: "generally less than 5 parts in 1e5" (BGS).
constexpr double kRelativeHalfWidth = 5e-5;
constexpr double kLowestHeightM = -500.0;
constexpr double kHighestHeightM = 9000.0;

// Somigliana, with the series in height to second order.
double normal_gravity(const Ellipsoid& ellipsoid, double sin2_latitude, double height_m) {
  // k = b gp / (a ge) - 1: taken from its definition, as its published digits (11) cost the tenth decimal at
  // the pole.
  const double k = (1.0 - ellipsoid.flattening) * ellipsoid.pole_mps2 / ellipsoid.equator_mps2 - 1.0;
  const double at_surface =
      ellipsoid.equator_mps2 * (1.0 + k * sin2_latitude) / std::sqrt(1.0 - ellipsoid.e2 * sin2_latitude);
  const double h = height_m / ellipsoid.semi_major_m;
  const double f = ellipsoid.flattening;
  return at_surface * (1.0 - 2.0 * (1.0 + f + ellipsoid.m - 2.0 * f * sin2_latitude) * h + 3.0 * h * h);
}

// The series of 1967, linear in height.
double series_gravity(double equator_mps2, double per_metre, Angle latitude, double height_m) {
  const SinCos sc = sincos(latitude);
  const double sin_twice = 2.0 * sc.sin * sc.cos;
  return equator_mps2 * (1.0 + 0.0053024 * sc.sin * sc.sin - 0.0000058 * sin_twice * sin_twice) -
         per_metre * height_m;
}

double value_mps2(Angle latitude, double height_m, GravityFormula formula) {
  const double sine = sincos(latitude).sin;
  switch (formula) {
    case GravityFormula::kWgs84:
      return normal_gravity(kWgs84Ellipsoid, sine * sine, height_m);
    case GravityFormula::kWelmec:
      return series_gravity(9.780318, 3.085e-6, latitude, height_m);
    case GravityFormula::kNpl:
      return series_gravity(9.780327, 3.086e-6, latitude, height_m);
    case GravityFormula::kGrs80:
      break;
  }
  return normal_gravity(kGrs80Ellipsoid, sine * sine, height_m);
}

constexpr auto kFormulas = names<GravityFormula>({{GravityFormula::kWgs84, "WGS84"},
                                                  {GravityFormula::kWelmec, "WELMEC"},
                                                  {GravityFormula::kNpl, "NPL"},
                                                  {GravityFormula::kGrs80, "GRS80"}});

}  // namespace

std::string_view to_string(GravityFormula formula) {
  return kFormulas.of(formula, "GRS80");
}

FormulaGravity formula_gravity(Angle latitude, double height_m, GravityFormula formula) {
  std::vector<std::string> problems;
  if (!(std::abs(latitude.deg()) <= 90.0))
    problems.push_back(fmt::format("latitude {} degrees; required: -90 to 90", latitude.deg()));
  if (!(height_m >= kLowestHeightM && height_m <= kHighestHeightM)) {
    problems.push_back(
        fmt::format("height {} m; required: {} to {}", height_m, kLowestHeightM, kHighestHeightM));
  }
  if (!problems.empty())
    throw std::invalid_argument(fmt::format("local gravity: {}", fmt::join(problems, ". Also: ")));
  FormulaGravity gravity;
  gravity.value_mps2 = value_mps2(latitude, height_m, formula);
  gravity.half_width_mps2 = kRelativeHalfWidth * gravity.value_mps2;
  gravity.standard_uncertainty_mps2 = gravity.half_width_mps2 / std::sqrt(3.0);
  gravity.source = fmt::format("formula {}, latitude {} degrees, height {} m", to_string(formula),
                               latitude.deg(), height_m);
  gravity.warning = fmt::format(
      "gravity is from a formula instead of a survey: it may be wrong by {:.1e} m/s2 (5e-5 of it), several "
      "times the uncertainty of an intrinsic sensitivity (1e-5); have the site surveyed. Angles, and offsets "
      "and sensitivities per g_loc, do not depend on it",
      gravity.half_width_mps2);
  return gravity;
}

}  // namespace abcal
