#include "protocol/statistics/distributions.h"

#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/normal.hpp>
#include <boost/math/distributions/students_t.hpp>
#include <boost/math/special_functions/beta.hpp>
#include <boost/math/special_functions/gamma.hpp>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace abcal {

namespace math = boost::math;

double normal_quantile(double p) {
  if (!(p > 0.0 && p < 1.0)) throw std::invalid_argument("probability must lie between 0 and 1");
  return math::quantile(math::normal(), p);
}

double normal_tail(double z) {
  return math::cdf(math::complement(math::normal(), z));
}

double normal_density(double z) {
  return math::pdf(math::normal(), z);
}

double student_t_above(double probability, double degrees_of_freedom) {
  constexpr double kAsGoodAsInfinite = 1e7;
  if (!(degrees_of_freedom >= 1.0)) return std::numeric_limits<double>::quiet_NaN();
  if (degrees_of_freedom > kAsGoodAsInfinite)
    return math::quantile(math::complement(math::normal(), probability));
  return math::quantile(math::complement(math::students_t(degrees_of_freedom), probability));
}

double student_t_tail(double t, double degrees_of_freedom) {
  if (std::isinf(degrees_of_freedom)) return normal_tail(t);
  return math::cdf(math::complement(math::students_t(degrees_of_freedom), t));
}

double student_t_between(double a, double b, double degrees_of_freedom) {
  const auto above = [&](double t) { return student_t_tail(t, degrees_of_freedom); };
  if (a > 0.0) return above(a) - above(b);
  if (b < 0.0) return above(-b) - above(-a);
  return 1.0 - above(-a) - above(b);
}

double chi2_quantile(double p, double degrees_of_freedom) {
  return math::quantile(math::chi_squared(degrees_of_freedom), p);
}

double chi2_above(double probability, double degrees_of_freedom) {
  return 2.0 * math::gamma_q_inv(0.5 * degrees_of_freedom, probability);
}

double chi2_tail(double chi2, int degrees_of_freedom) {
  if (degrees_of_freedom < 1 || !(chi2 >= 0.0)) return std::numeric_limits<double>::quiet_NaN();
  if (!std::isfinite(chi2)) return 0.0;
  return math::gamma_q(0.5 * static_cast<double>(degrees_of_freedom), 0.5 * chi2);
}

double chi2_lower_tail(double chi2, int degrees_of_freedom) {
  if (degrees_of_freedom < 1 || !(chi2 >= 0.0)) return std::numeric_limits<double>::quiet_NaN();
  if (!std::isfinite(chi2)) return 1.0;
  return math::gamma_p(0.5 * static_cast<double>(degrees_of_freedom), 0.5 * chi2);
}

double f_tail(double chi2, int degrees_of_freedom, double of_noise) {
  if (!std::isfinite(of_noise)) return chi2_tail(chi2, degrees_of_freedom);
  return math::ibetac(0.5 * degrees_of_freedom, 0.5 * of_noise, chi2 / (chi2 + of_noise));
}

}  // namespace abcal
