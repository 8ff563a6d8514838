#include "protocol/uncertainty/gum_validation.h"

#include <cmath>

#include "protocol/statistics/distributions.h"
#include "protocol/uncertainty/monte_carlo.h"

namespace abcal {

GumValidation validate_gum(const GumEstimate& estimate, const MonteCarloInterval& monte_carlo, int digits) {
  GumValidation validation;
  const auto [y, u] = estimate;
  const double k = normal_quantile(0.5 + 0.5 * monte_carlo.p);
  validation.expanded_uncertainty = k * u;
  validation.d_low = std::abs(y - validation.expanded_uncertainty - monte_carlo.interval.low);
  validation.d_high = std::abs(y + validation.expanded_uncertainty - monte_carlo.interval.high);
  validation.tolerance = numerical_tolerance(u, digits);
  validation.validated =
      validation.d_low <= validation.tolerance && validation.d_high <= validation.tolerance;
  // Standard deviation of a quantile of M normal values.
  const double tail = 0.5 * (1.0 - monte_carlo.p);
  const double end_point = u * std::sqrt(tail * (1.0 - tail) / monte_carlo.trials) / normal_density(k);
  validation.decided = 2.0 * end_point <= validation.tolerance / 5.0;
  return validation;
}

}  // namespace abcal
