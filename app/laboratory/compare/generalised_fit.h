#pragma once

#include <Eigen/Core>

namespace abcal {

/// A fit by generalised least squares: values = design * parameters, with errors of a known covariance.
struct GeneralisedFit {
  Eigen::VectorXd parameters;
  Eigen::MatrixXd covariance;  ///< That of the parameters.
  Eigen::MatrixXd map;         ///< parameters = map * values
  double chi2 = 0.0;
  int degrees_of_freedom = 0;
};

/// @throws std::invalid_argument a variance that is not above 0, a covariance that is not positive definite,
/// a parameter that no value determines
GeneralisedFit generalised_fit(const Eigen::MatrixXd& design, const Eigen::VectorXd& values,
                               const Eigen::MatrixXd& covariance);

/// The mean of p quantities over n results, of those values that are chosen.
/// @param values      n p, result by result
/// @param covariance  n p x n p
/// @param chosen      n x p: not 0 where a value is part of the mean
/// @return p parameters; `map` has zeros for the other values
/// @throws std::invalid_argument as generalised_fit()
GeneralisedFit generalised_mean(const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance,
                                const Eigen::MatrixXi& chosen);

}  // namespace abcal
