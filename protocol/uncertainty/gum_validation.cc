#include "protocol/uncertainty/gum_validation.h"

#include <cmath>
#include <numbers>
#include <stdexcept>

#include "protocol/uncertainty/monte_carlo.h"

namespace abcal {

namespace {

double normal_density(double x) {
  return std::exp(-0.5 * x * x) / std::sqrt(2.0 * std::numbers::pi);
}

}  // namespace

double normal_quantile(double p) {
  if (!(p > 0.0 && p < 1.0)) throw std::invalid_argument("probability must lie between 0 and 1");
  if (p > 0.5) return -normal_quantile(1.0 - p);
  // From the left tail the steps go up to the root without overshooting, since the distribution is convex
  // there.
  double x = -std::sqrt(-2.0 * std::log(p));
  for (int i = 0; i < 200; ++i) {
    const double step = (0.5 * std::erfc(-x / std::numbers::sqrt2) - p) / normal_density(x);
    x -= step;
    if (std::abs(step) < 1e-15 * (1.0 + std::abs(x))) break;
  }
  return x;
}

GumValidation validate_gum(double y, double u, const CoverageInterval& monte_carlo, double trials, double p,
                           int digits) {
  GumValidation validation;
  const double k = normal_quantile(0.5 + 0.5 * p);
  validation.expanded_uncertainty = k * u;
  validation.d_low = std::abs(y - validation.expanded_uncertainty - monte_carlo.low);
  validation.d_high = std::abs(y + validation.expanded_uncertainty - monte_carlo.high);
  validation.tolerance = numerical_tolerance(u, digits);
  validation.validated =
      validation.d_low <= validation.tolerance && validation.d_high <= validation.tolerance;
  // Standard deviation of a quantile of M normal values.
  const double tail = 0.5 * (1.0 - p);
  const double end_point = u * std::sqrt(tail * (1.0 - tail) / trials) / normal_density(k);
  validation.decided = 2.0 * end_point <= validation.tolerance / 5.0;
  return validation;
}

}  // namespace abcal
