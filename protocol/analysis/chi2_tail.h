#pragma once

namespace abcal {

/// P(chi2 with `degrees_of_freedom` >= `chi2`); NaN without degrees of freedom.
double chi2_tail(double chi2, int degrees_of_freedom);

}  // namespace abcal
