#include "protocol/uncertainty/certified_uncertainty.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/uncertainty/joint_trials.h"
#include "protocol/uncertainty/monte_carlo.h"

namespace abcal {
namespace {

/// Probability that the lower bound of a quantile is above it.
constexpr double kBoundFails = 0.01;
/// Probability of the stated expanded uncertainties: that of coverage_factor().
constexpr double kStatedProbability = 0.9544997361036416;

/// The largest k for which fewer than k of `count` errors lie below the quantile p with at most kBoundFails
/// probability (binomial): the k-th smallest is a lower bound of the quantile. 0: none.
std::size_t rank_of_lower_bound(std::size_t count, double p) {
  const auto n = static_cast<double>(count);
  double below = 0.0;
  for (std::size_t k = 0; k <= count; ++k) {
    const auto at = static_cast<double>(k);
    below += std::exp(std::lgamma(n + 1.0) - std::lgamma(at + 1.0) - std::lgamma(n - at + 1.0) +
                      at * std::log(p) + (n - at) * std::log1p(-p));
    if (below > kBoundFails) return k;
  }
  return count;
}

}  // namespace

ErrorQuantile error_quantile(std::vector<double>& magnitudes, double p) {
  if (!(p > 0.0 && p < 1.0)) throw std::invalid_argument("a quantile of a probability outside 0 to 1");
  const std::size_t lower = rank_of_lower_bound(magnitudes.size(), p);
  if (lower == 0) throw std::invalid_argument("too few trials for the bound of a quantile");
  std::sort(magnitudes.begin(), magnitudes.end());
  const auto found = static_cast<std::size_t>(std::ceil(p * static_cast<double>(magnitudes.size())));
  return {magnitudes[std::min(found, magnitudes.size()) - 1], magnitudes[lower - 1]};
}

bool CertifiedUncertainty::any_larger() const {
  return std::any_of(outputs.begin(), outputs.end(),
                     [](const CertifiedExpanded& one) { return one.is_larger(); });
}

std::string CertifiedUncertainty::larger() const {
  std::string names;
  for (int k = 0; k < kStudyOutputs; ++k) {
    if (!outputs[static_cast<std::size_t>(k)].is_larger()) continue;
    names += names.empty() ? "" : ", ";
    names += output_symbol(k);
  }
  return names;
}

Covariance12 CertifiedUncertainty::covariance(const Covariance12& stated) const {
  // In units of the larger of both, so that the elements are comparable; 1 where an output has none.
  const Eigen::VectorXd u =
      stated.diagonal().cwiseMax(mean_squares.diagonal().head<12>()).unaryExpr([](double square) {
        return square > 0.0 ? std::sqrt(square) : 1.0;
      });
  const Eigen::VectorXd over_u = u.cwiseInverse();
  const SymmetricEigen excess =
      symmetric_eigen(scaled_on_both_sides(mean_squares.topLeftCorner<12, 12>() - stated, over_u));
  const Eigen::MatrixXd more =
      covariance_of_root(scaled_columns(excess.vectors, excess.values.cwiseMax(0.0).cwiseSqrt()));
  return stated + scaled_on_both_sides(more, u);
}

double CertifiedUncertainty::standard_uncertainty(int output, double k) const {
  const CertifiedExpanded& one = outputs.at(static_cast<std::size_t>(output));
  return one.is_larger() ? one.monte_carlo.found / k : 0.0;
}

CertifiedUncertainty certified_uncertainty(const RunRecord& record, const CalibrationResult& result,
                                           const ItemFit& own, std::uint64_t seed, std::uint64_t trials) {
  CertifiedUncertainty out;
  out.trials = trials;
  out.seed = seed;
  const JointTrials truths(own, record, seed, TruthFrom::kPosterior);
  MonteCarloOptions options;
  options.trials = trials;
  std::vector<std::vector<double>> errors(kStudyOutputs, std::vector<double>(trials));
  const MonteCarloResult made = run_monte_carlo(
      kStudyOutputs,
      [&](std::uint64_t first, std::size_t count, double* block) {
        truths(first, count, block);
        // Blocks do not overlap, so that no two threads write to one place.
        for (std::size_t k = 0; k < kStudyOutputs; ++k)
          std::copy_n(block + k * count, count, errors[k].begin() + static_cast<std::ptrdiff_t>(first));
      },
      options);
  out.mean_squares = made.covariance + made.mean * made.mean.transpose();
  const std::vector<Quantity> quantities = quantities_of_outputs(result);
  for (std::size_t k = 0; k < kStudyOutputs; ++k) {
    for (double& error : errors[k]) error = std::abs(error);
    const Quantity& quantity = quantities[k];
    out.outputs[k] = {coverage_factor(quantity, kStatedProbability) * quantity.standard_uncertainty,
                      error_quantile(errors[k], kStatedProbability)};
  }
  return out;
}

std::optional<CertifiedUncertainty> certified_uncertainty_of(const RunRecord& record,
                                                             const CalibrationResult& result,
                                                             const std::string& sha256) {
  if (result.estimator != "joint" || result.verdict == Verdict::kNotUsable || record.stage_record.record)
    return std::nullopt;
  JointOptions options;
  options.measured_alignment = record.measured_alignment;
  const ItemFit own = fit_item(record, options);
  if (!own.solution) return std::nullopt;
  return certified_uncertainty(record, result, own, seed_of_sha256(sha256));
}

std::uint64_t seed_of_sha256(const std::string& sha256) {
  return std::stoull(sha256.substr(0, 16), nullptr, 16);
}

}  // namespace abcal
