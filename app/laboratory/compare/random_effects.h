#pragma once

#include <Eigen/Core>
#include <vector>

namespace abcal {

/// The mean of one property over several results whose uncertainties, type B included, may be correlated,
/// with the scatter of the results beyond their uncertainties (random effects: each result is off by an
/// effect of its own, of variance between^2).
struct RandomEffectsMean {
  double mean = 0.0;
  double standard_uncertainty = 0.0;
  double between = 0.0;  ///< Standard deviation of the results' own effects; 0: uncertainties explain all.
  std::vector<double>
      normalised_error;  ///< E_n of each result against the mean, by its stated uncertainty (k = 2).
};

/// The generalised least-squares mean. `between` solves r' (V + between^2 I)^-1 r = n - 1, r being the
/// residuals (Mandel and Paule for correlated results). E_n takes the covariance of a result with the mean
/// into account.
/// @param covariance  V of the results, positive definite
/// @throws std::invalid_argument if it is not, or has another size; std::runtime_error if no finite mean
/// follows
RandomEffectsMean random_effects_mean(const std::vector<double>& values, const Eigen::MatrixXd& covariance);

}  // namespace abcal
