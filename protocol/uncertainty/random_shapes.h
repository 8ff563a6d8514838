#pragma once

#include "protocol/plan/effect_sizes.h"
#include "protocol/uncertainty/random_stream.h"

namespace abcal {

/// The next value of a distribution of this shape with mean 0 and standard deviation 1.
double standard_draw(Shape shape, RandomStream& stream);

/// The next value of chi2 with these degrees of freedom, which need not be a whole number (Marsaglia and
/// Tsang, ACM Trans. Math. Softw. 26, 363, 2000). @param degrees_of_freedom  2 or more
double chi2_draw(double degrees_of_freedom, RandomStream& stream);

/// The next value of Student's t; normal for infinitely many degrees of freedom.
/// @param degrees_of_freedom  2 or more
double student_t_draw(double degrees_of_freedom, RandomStream& stream);

}  // namespace abcal
