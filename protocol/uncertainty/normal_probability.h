#pragma once

#include <cmath>
#include <numbers>

namespace abcal {

/// Probability that a standard normal value lies below z, to full relative precision also far below 0; for
/// the probability above z take that below -z.
inline double normal_below(double z) {
  return 0.5 * std::erfc(-z / std::numbers::sqrt2);
}

}  // namespace abcal
