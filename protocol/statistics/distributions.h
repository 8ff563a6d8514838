#pragma once

namespace abcal {

// Distributions of statistics, from Boost.Math. Compiled once: their templates take the compiler seconds in
// every source that names them. A tail is the probability to exceed a value, a `_above` the value that is
// exceeded with a probability.

/// The value below which a standard normal deviate lies with probability p.
/// @throws std::invalid_argument unless 0 < p < 1
double normal_quantile(double p);

/// P(z >= `z`) of a standard normal deviate.
double normal_tail(double z);

/// Density of a standard normal deviate at z.
double normal_density(double z);

/// The value that Student's t with these degrees of freedom exceeds with this probability, 0 to 1. From 1e7
/// degrees of freedom on, that of the normal distribution; NaN below 1.
double student_t_above(double probability, double degrees_of_freedom);

/// P(t >= `t`) of Student's t. Infinitely many degrees of freedom: the normal distribution.
double student_t_tail(double t, double degrees_of_freedom);

/// P(a <= t <= b) of Student's t, without cancellation where both are in one tail.
double student_t_between(double a, double b, double degrees_of_freedom);

/// The value below which chi2 with these degrees of freedom lies with probability p.
double chi2_quantile(double p, double degrees_of_freedom);

/// The value that chi2 with these degrees of freedom exceeds with this probability; for small probabilities,
/// where 1 - p would lose its digits.
double chi2_above(double probability, double degrees_of_freedom);

/// P(chi2 with `degrees_of_freedom` >= `chi2`); NaN without degrees of freedom.
double chi2_tail(double chi2, int degrees_of_freedom);

/// P(value <= chi2), to its relative precision however small it is. NaN as chi2_tail().
double chi2_lower_tail(double chi2, int degrees_of_freedom);

/// The tail probability if the noise was estimated with `of_noise` degrees of freedom: P(F >= chi2 /
/// degrees_of_freedom). Infinite: the noise is known.
double f_tail(double chi2, int degrees_of_freedom, double of_noise);

}  // namespace abcal
