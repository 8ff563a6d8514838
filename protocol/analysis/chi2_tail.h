#pragma once

namespace abcal {

/// P(chi2 with `degrees_of_freedom` >= `chi2`); NaN without degrees of freedom.
double chi2_tail(double chi2, int degrees_of_freedom);

/// The same where the noise was estimated with `of_noise` degrees of freedom: P(F >= chi2 /
/// degrees_of_freedom). Infinite: it is known.
double f_tail(double chi2, int degrees_of_freedom, double of_noise);

}  // namespace abcal
