#pragma once

#include <Eigen/Core>
#include <compare>
#include <cstddef>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/shared/noise_process.h"
#include "protocol/estimators/shared/normal_matrix.h"

namespace abcal {

/// A noise of the readings, and the stated size of the step errors that are not estimated one by one.
struct AssumedNoise {
  double tau = 0.0;  ///< Process standard deviation, in units of each output's median u.
  double rho = 1.0;  ///< Correlation length of the process, in angles.
  Eigen::Vector3d white = Eigen::Vector3d::Ones();  ///< White standard deviations over the u given.
  double step_sd = 0.0;  ///< Standard deviation of the step errors without memory (radian).
};

/// The linear problem of an effect_fit() at one noise.
struct AtNoise {
  AssumedNoise noise;
  double log_likelihood = 0.0;  ///< Restricted likelihood.
  double chi2 = 0.0;
  Eigen::VectorXd change;  ///< Change of the model's value.
  std::optional<NoiseWhitener> whitener;
  ReadingRows whitened_jacobian;
  Eigen::VectorXd whitened_residual;
  NormalMatrix normal;  ///< Its inverse is the posterior covariance of the unknowns.
};

AtNoise solve_at(const EffectModel& model, const AssumedNoise& noise);

/// White noise of each output in units of u, and its degrees of freedom.
struct WhiteFound {
  Eigen::Vector3d white = Eigen::Vector3d::Ones();
  Eigen::Vector3d redundancy = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
};

/// The white noise with which the weighted squares of the residuals equal their expectation (restricted
/// likelihood).
/// @throws UnusableData the readings leave nothing to estimate it from
WhiteFound estimate_white(const EffectModel& model);

/// The probable noises; white noise alone is first, even if it is improbable.
struct NoiseSearch {
  WhiteFound white;
  std::vector<AtNoise> points;
  std::vector<double> log_weights;  ///< Logarithms of their posterior probabilities.
  double log_evidence = 0.0;        ///< Evidence from all noises, on the scale of log_likelihood.
  double weight(std::size_t i) const;
  std::size_t best() const;
};

/// The logarithm of the sum of exp(log), without overflow.
double log_of_sum(std::span<const double> logs);

/// A noise of the search; white alone, of the stated or estimated size, by default.
struct NoiseCandidate {
  double tau = 0.0;  ///< As in AssumedNoise.
  double rho = 1.0;
  double white = 1.0;  ///< White standard deviation over that stated or estimated.
  auto operator<=>(const NoiseCandidate&) const = default;
};

/// Facts that the search knows of the readings at one noise.
struct NoiseLikelihood {
  double log_likelihood = 0.0;
  double chi2 = 0.0;
};
using NoiseAnswer = std::function<NoiseLikelihood(const NoiseCandidate&)>;

/// The rules that decide which noises are tried.
struct NoiseQuestion {
  bool process = true;      ///< false: the noise is white.
  bool white_known = true;  ///< The readings' uncertainties are stated.
  double readings = 0.0;    ///< Number of single outputs' readings, 3 N.
};

struct ProbableNoise {
  NoiseCandidate noise;
  double log_weight = 0.0;  ///< Logarithm of the posterior probability.
};
struct ProbableNoises {
  std::vector<ProbableNoise> noises;  ///< White noise alone is first, even if it is improbable.
  double log_evidence = 0.0;          ///< Evidence from all noises, on the scale of log_likelihood.
};

/// The rule of the search: which noises are tried, and their posterior probabilities.
/// @param at  called once for each noise that is tried, first for white noise alone
ProbableNoises probable_noises(const NoiseQuestion& question, const NoiseAnswer& at);

/// Every noise that the search may try.
std::vector<NoiseCandidate> noise_candidates(const NoiseQuestion& question);

/// A candidate at the white noise of the readings.
AssumedNoise assumed_noise(const EffectModel& model, const WhiteFound& white,
                           const NoiseCandidate& candidate);

/// Averages over a grid of noise processes by their restricted likelihoods, with a prior probability of 1/2
/// for none.
/// @throws UnusableData the readings leave nothing to estimate their white noise from, where it is asked for
NoiseSearch search_noise(const EffectModel& model);

}  // namespace abcal
