#include "app/laboratory/compare/random_effects.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace abcal {
namespace {

/// A generalised least-squares mean with the weights that make it.
struct WeightedMean {
  double mean = 0.0;
  double variance = 0.0;
  double chi2 = 0.0;
  Eigen::VectorXd weights;
};

WeightedMean weighted_mean(const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance) {
  const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
  if (factor.info() != Eigen::Success)
    throw std::invalid_argument("the covariance of the results is not positive definite");
  const Eigen::VectorXd of_one = factor.solve(Eigen::VectorXd::Ones(values.size()));
  WeightedMean result;
  result.variance = 1.0 / of_one.sum();
  result.weights = of_one * result.variance;
  result.mean = result.weights.dot(values);
  const Eigen::VectorXd residuals = values.array() - result.mean;
  result.chi2 = residuals.dot(factor.solve(residuals));
  return result;
}

double between_variance_of(const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance) {
  const double degrees_of_freedom = static_cast<double>(values.size() - 1);
  const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(values.size(), values.size());
  const auto chi2 = [&](double variance) {
    return weighted_mean(values, covariance + variance * identity).chi2;
  };
  // With it alone chi2 is at most the sum of squares over the variance.
  return between_variance(chi2, degrees_of_freedom,
                          (values.array() - values.mean()).square().sum() / degrees_of_freedom);
}

}  // namespace

double between_variance(const std::function<double(double)>& chi2, double degrees_of_freedom, double scale) {
  if (chi2(0.0) <= degrees_of_freedom) return 0.0;
  double low = 0.0, high = scale;
  while (chi2(high) > degrees_of_freedom) high *= 2.0;
  constexpr int kHalvings = 200;  // More than a double has digits.
  for (int k = 0; k < kHalvings && high - low > 1e-15 * high; ++k) {
    const double middle = 0.5 * (low + high);
    (chi2(middle) > degrees_of_freedom ? low : high) = middle;
  }
  return high;
}

RandomEffectsMean random_effects_mean(const std::vector<double>& values, const Eigen::MatrixXd& covariance,
                                      const MeanOptions& options) {
  const auto n = static_cast<Eigen::Index>(values.size());
  std::vector<Eigen::Index> kept;
  for (Eigen::Index i = 0; i < n; ++i) {
    if (std::ranges::find(options.left_out, static_cast<std::size_t>(i)) == options.left_out.end())
      kept.push_back(i);
  }
  if (kept.size() < 2 || covariance.rows() != n || covariance.cols() != n)
    throw std::invalid_argument("a mean of random effects needs two results or more, and their covariance");
  const Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(values.data(), n);
  const Eigen::VectorXd x_kept = x(kept);
  const Eigen::MatrixXd v = covariance(kept, kept);
  const double variance = between_variance_of(x_kept, v);
  const Eigen::MatrixXd own = variance * Eigen::MatrixXd::Identity(x_kept.size(), x_kept.size());
  const WeightedMean mean = weighted_mean(x_kept, v + own);
  RandomEffectsMean result;
  result.mean = mean.mean;
  const Eigen::MatrixXd& largest =
      options.largest_covariance.size() == 0 ? covariance : options.largest_covariance;
  result.standard_uncertainty =
      std::sqrt(mean.weights.dot((Eigen::MatrixXd(largest(kept, kept)) + own) * mean.weights));
  result.between = std::sqrt(variance);
  if (!std::isfinite(result.mean) || !std::isfinite(result.standard_uncertainty))
    throw std::runtime_error("the results have no finite mean");
  // The claims are judged by their own uncertainties, without the effects that they do not cover.
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(n);
  weights(kept) = mean.weights;
  const Eigen::VectorXd with_mean = covariance * weights;
  const double of_mean = weights.dot(with_mean);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double u2 = covariance(i, i) - 2.0 * with_mean(i) + of_mean;
    const double difference = x(i) - mean.mean;
    constexpr double kCoverage = 2.0;
    result.normalised_error.push_back(u2 > 0.0 ? difference / (kCoverage * std::sqrt(u2)) : 0.0);
  }
  return result;
}

}  // namespace abcal
