#include "protocol/analysis/chi2_tail.h"

#include <boost/math/special_functions/beta.hpp>
#include <boost/math/special_functions/gamma.hpp>
#include <cmath>
#include <limits>

namespace abcal {

double chi2_tail(double chi2, int degrees_of_freedom) {
  if (degrees_of_freedom < 1 || !(chi2 >= 0.0)) return std::numeric_limits<double>::quiet_NaN();
  if (!std::isfinite(chi2)) return 0.0;
  return boost::math::gamma_q(0.5 * static_cast<double>(degrees_of_freedom), 0.5 * chi2);
}

double f_tail(double chi2, int degrees_of_freedom, double of_noise) {
  if (!std::isfinite(of_noise)) return chi2_tail(chi2, degrees_of_freedom);
  return boost::math::ibetac(0.5 * degrees_of_freedom, 0.5 * of_noise, chi2 / (chi2 + of_noise));
}

}  // namespace abcal
