#pragma once

#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/uncertainty/coverage.h"

namespace abcal {

/// Whether the GUM framework (first order, normal distribution) may be used in place of the Monte Carlo
/// method for one output (JCGM 101:2008, section 8).
struct GumValidation {
  double expanded_uncertainty = 0.0;  ///< U_p of the GUM framework.
  double d_low = 0.0, d_high = 0.0;   ///< |y -+ U_p - y_low, y_high|
  double tolerance = 0.0;             ///< delta: half a unit of the last meaningful digit of u(y).
  bool validated = false;             ///< Both differences are at most delta.
  /// The Monte Carlo end points are good to delta/5, as section 8.2 asks; else the verdict may be chance.
  bool decided = false;
};

/// An estimate by the GUM framework.
struct GumEstimate {
  double y = 0.0;
  double u = 0.0;  ///< Its standard uncertainty.
};

/// The Monte Carlo result with which it is compared.
struct MonteCarloInterval {
  CoverageInterval interval;  ///< Probabilistically symmetric.
  double trials = 0.0;
  double p = kCoverageProbability;  ///< Coverage probability.
};

/// @param digits  significant digits of u that are meaningful, 1 or 2
/// @throws std::invalid_argument if p is not within (0, 1)
GumValidation validate_gum(const GumEstimate& estimate, const MonteCarloInterval& monte_carlo, int digits);

}  // namespace abcal
