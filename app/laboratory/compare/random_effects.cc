#include "app/laboratory/compare/random_effects.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/laboratory/compare/generalised_fit.h"

namespace abcal {

double between_variance(const Eigen::VectorXd& values, const Eigen::MatrixXd& covariance,
                        Eigen::Index quantities) {
  const Eigen::MatrixXi all = Eigen::MatrixXi::Ones(values.size() / quantities, quantities);
  const auto degrees_of_freedom = static_cast<double>(values.size() - quantities);
  const auto chi2 = [&](double variance) {
    Eigen::MatrixXd with_effects = covariance;
    with_effects.diagonal().array() += variance;
    return generalised_mean(values, with_effects, all).chi2;
  };
  if (chi2(0.0) <= degrees_of_freedom) return 0.0;
  double low = 0.0, high = covariance.diagonal().maxCoeff();
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
  const double variance = between_variance(x_kept, v, 1);
  const Eigen::MatrixXd own = variance * Eigen::MatrixXd::Identity(x_kept.size(), x_kept.size());
  const GeneralisedFit mean = generalised_mean(x_kept, v + own, Eigen::MatrixXi::Ones(x_kept.size(), 1));
  const Eigen::VectorXd weights_kept = mean.map.row(0).transpose();
  RandomEffectsMean result;
  result.mean = mean.parameters(0);
  const Eigen::MatrixXd& largest =
      options.largest_covariance.size() == 0 ? covariance : options.largest_covariance;
  result.standard_uncertainty =
      std::sqrt(weights_kept.dot((Eigen::MatrixXd(largest(kept, kept)) + own) * weights_kept));
  result.between = std::sqrt(variance);
  if (!std::isfinite(result.mean) || !std::isfinite(result.standard_uncertainty))
    throw std::runtime_error("the results have no finite mean");
  // The claims are judged by their own uncertainties, without the effects that they do not cover.
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(n);
  weights(kept) = weights_kept;
  const Eigen::VectorXd with_mean = covariance * weights;
  const double of_mean = weights.dot(with_mean);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double u2 = covariance(i, i) - 2.0 * with_mean(i) + of_mean;
    const double difference = x(i) - result.mean;
    constexpr double kCoverage = 2.0;
    result.normalised_error.push_back(u2 > 0.0 ? difference / (kCoverage * std::sqrt(u2)) : 0.0);
  }
  return result;
}

}  // namespace abcal
