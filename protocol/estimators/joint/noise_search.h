#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/shared/noise_process.h"
#include "protocol/estimators/shared/normal_matrix.h"

namespace abcal {

/// A noise of the readings, and what is stated of the errors that are not estimated one by one.
struct AssumedNoise {
  double tau = 0.0;                                 ///< Of the process, in units of each output's usual u.
  double rho = 1.0;                                 ///< Angles.
  Eigen::Vector3d white = Eigen::Vector3d::Ones();  ///< White standard deviations over the u given.
  double step_sd = 0.0;                             ///< Of the step errors without memory (radian).
};

/// The linear problem of an effect_fit() at one noise.
struct AtNoise {
  AssumedNoise noise;
  double log_likelihood = 0.0;  ///< Restricted.
  double chi2 = 0.0;
  Eigen::VectorXd change;  ///< Of the model's value.
  std::optional<NoiseWhitener> whitener;
  ReadingRows whitened_jacobian;
  Eigen::VectorXd whitened_residual;
  NormalMatrix normal;  ///< Its inverse is the posterior covariance of the unknowns.
};

AtNoise solve_at(const EffectModel& model, const AssumedNoise& noise);

/// White noise of each output in units of u, and the degrees of freedom that it is known with.
struct WhiteFound {
  Eigen::Vector3d white = Eigen::Vector3d::Ones();
  Eigen::Vector3d redundancy = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
};

/// The white noise with which the weighted squares of the residuals equal their expectation (restricted
/// likelihood).
/// @throws UnusableData the readings leave nothing to estimate it from
WhiteFound estimate_white(const EffectModel& model);

/// The noises that are probable; white noise alone stands first, whatever its probability.
struct NoiseSearch {
  WhiteFound white;
  std::vector<AtNoise> points;
  std::vector<double> log_weights;  ///< Of their posterior probabilities.
  double log_evidence = 0.0;        ///< Of the readings, by all of them; on the scale of log_likelihood.
  double weight(std::size_t i) const;
  std::size_t best() const;
};

/// The logarithm of the sum of exp(log), without overflow.
double log_of_sum(std::span<const double> logs);

/// Averages over a grid of noise processes by their restricted likelihoods, with a prior probability of 1/2
/// for none.
/// @throws UnusableData the readings leave nothing to estimate their white noise from, where it is asked for
NoiseSearch search_noise(const EffectModel& model);

}  // namespace abcal
