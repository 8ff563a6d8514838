#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

namespace abcal {

/// The mean of one property over several results whose uncertainties, type B included, may be correlated,
/// with the scatter of the results beyond their uncertainties (random effects: each result is off by an
/// effect of its own, of variance between^2).
struct RandomEffectsMean {
  double mean = 0.0;
  double standard_uncertainty = 0.0;
  double between = 0.0;  ///< Standard deviation of the results' own effects; 0: uncertainties explain all.
  /// E_n of each result against the mean, by its stated uncertainty (k = 2); of a result that was left out of
  /// the mean, too.
  std::vector<double> normalised_error;
};

/// The results that make the mean, and what they may have in common.
struct MeanOptions {
  std::vector<std::size_t> left_out;  ///< Positions of results that are not part of the mean.
  /// The covariance with the largest part that the results may have in common; empty: as `covariance`. The
  /// uncertainty of the mean is that which it gives, so that what may be common is not averaged down.
  Eigen::MatrixXd largest_covariance;
};

/// The variance of the results' own effects that makes chi2 about the mean equal to its degrees of freedom
/// (Mandel and Paule for correlated results); 0 where chi2 is no larger without it. All p quantities have
/// one.
/// @param values      n p, result by result
/// @param covariance  n p x n p
/// @throws std::invalid_argument as generalised_mean()
double between_variance(const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance,
                        Eigen::Index quantities);

/// The generalised least-squares mean. `between` solves r' (V + between^2 I)^-1 r = n - 1, r being the
/// residuals (Mandel and Paule for correlated results). E_n takes the covariance of a result with the mean
/// into account.
/// @param covariance  V of the results, positive definite: what is known to be common, and nothing else
/// @throws std::invalid_argument if it is not, or has another size; std::runtime_error if no finite mean
/// follows
RandomEffectsMean random_effects_mean(const std::vector<double>& values, const Eigen::MatrixXd& covariance,
                                      const MeanOptions& options = {});

}  // namespace abcal
