#include "protocol/estimators/joint/noise_search.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <span>
#include <utility>

#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/unusable_data.h"

namespace abcal {
namespace {

/// The grid of the noise process: rho in angles with its prior probability, tau in units of u. Effects of the
/// stage and drifts absorb most slow changes of the readings, so that a run hardly determines rho; the longer
/// it is the larger are the uncertainties. The grid is finer for slow processes: they differ by their change
/// from angle to angle, tau sqrt(2/rho), and for each rho the grid must contain the change of the readings.
struct CorrelationLength {
  double rho, prior;
  std::span<const double> tau;
};
constexpr std::array<double, 5> kTauOfFast{0.3, 0.8, 2.0, 5.0, 12.0};
constexpr std::array<double, 7> kTauOfSlow{0.3, 0.8, 2.0, 3.5, 5.5, 8.0, 12.0};
constexpr std::array<CorrelationLength, 4> kGrid{CorrelationLength{2.0, 0.1, kTauOfFast},
                                                 {10.0, 0.15, kTauOfFast},
                                                 {50.0, 0.25, kTauOfSlow},
                                                 {400.0, 0.5, kTauOfSlow}};
/// Readings that scatter less than stated (chi2 below this share of its degrees of freedom): the stated noise
/// may itself be the process, with little white noise, or the white noise is small. The uncertainties remain
/// those of the stated white noise; a smaller one only raises the probability of white noise alone.
constexpr double kScattersLess = 0.8;
constexpr double kLittleWhite = 0.2;
constexpr std::array<double, 3> kTauOfStatedNoise{0.5, 1.0, 2.0};
constexpr std::array<double, 3> kRhoOfStatedNoise{2.0, 10.0, 50.0};
constexpr std::array<double, 5> kSmallerWhite{0.7, 0.5, 0.35, 0.25, 0.1};
/// A process less probable than this, relative to white noise alone, is left out.
constexpr double kNegligibleWeight = 1e-6;
/// Estimation of the white noise ends when that of no output changes by more (relative), or after this number
/// of passes.
constexpr double kWhiteFound = 1e-3;
constexpr int kWhitePasses = 60;

/// State of the search: log_weights are relative to white noise alone until they are normalised.
class Search {
 public:
  Search(const NoiseQuestion& question, const NoiseAnswer& at) : question_(question), at_(at) {
    stated_ = at(NoiseCandidate{});
    out_.push_back({NoiseCandidate{}, question.process ? std::log(0.5) : 0.0});
  }

  void try_processes() {
    const bool of_stated_noise =
        question_.white_known && stated_.chi2 < kScattersLess * (question_.readings - 12.0);
    if (of_stated_noise) try_smaller_white();
    // Prior probability that a process is combined with the stated white noise.
    const double beside = of_stated_noise ? 0.5 : 1.0;
    for (const CorrelationLength& length : kGrid) {
      const double prior = 0.5 * beside * length.prior / static_cast<double>(length.tau.size());
      for (const double tau : length.tau) {
        const double gain = try_one({tau, length.rho, 1.0}, prior);
        // Larger processes are less likely still.
        if (tau > 0.5 && gain < largest() - 20.0) break;
      }
    }
    if (!of_stated_noise) return;
    constexpr double kPrior = 0.25 / static_cast<double>(kTauOfStatedNoise.size() * kRhoOfStatedNoise.size());
    for (const double tau : kTauOfStatedNoise) {
      for (const double rho : kRhoOfStatedNoise) try_one({tau, rho, kLittleWhite}, kPrior);
    }
  }

  ProbableNoises found() && {
    std::vector<double> logs;
    for (const ProbableNoise& one : out_) logs.push_back(one.log_weight);
    const double total = log_of_sum(logs);
    for (ProbableNoise& one : out_) one.log_weight -= total;
    return {std::move(out_), stated_.log_likelihood + total};
  }

 private:
  double largest() const {
    double most = out_.front().log_weight;
    for (const ProbableNoise& one : out_) most = std::max(most, one.log_weight);
    return most;
  }

  /// Gives white noise alone the probability that it has at the standard deviation that fits best.
  void try_smaller_white() {
    double gain = 0.0;
    for (const double white : kSmallerWhite)
      gain = std::max(gain, at_({0.0, 1.0, white}).log_likelihood - stated_.log_likelihood);
    out_.front().log_weight += gain;
  }

  double try_one(const NoiseCandidate& noise, double prior) {
    const double gain = at_(noise).log_likelihood - stated_.log_likelihood + std::log(prior);
    if (gain < std::log(kNegligibleWeight) || !std::isfinite(gain)) return gain;
    out_.push_back({noise, gain});
    return gain;
  }

  const NoiseQuestion& question_;
  const NoiseAnswer& at_;
  NoiseLikelihood stated_;
  std::vector<ProbableNoise> out_;
};

}  // namespace

AtNoise solve_at(const EffectModel& model, const AssumedNoise& noise) {
  AtNoise out;
  out.noise = noise;
  const NoiseWhitener& whitener = out.whitener.emplace(model.noise_at_angles(noise.white), noise.step_sd,
                                                       model.process_of(noise.tau, noise.rho));
  out.whitened_jacobian = model.jacobian();
  whitener.whiten(out.whitened_jacobian);
  ReadingRows residual = model.residual();
  whitener.whiten(residual);
  const Eigen::VectorXd& prior_weight = model.prior_weight();
  Eigen::MatrixXd normal = products_of_columns(out.whitened_jacobian);
  normal.diagonal() += prior_weight;
  out.normal.compute(std::move(normal));
  const Eigen::VectorXd from_prior = model.from_prior();
  Eigen::VectorXd right = out.whitened_jacobian.transpose() * residual;
  right -= prior_weight.cwiseProduct(from_prior);
  out.change = out.normal.solve(right);
  out.whitened_residual = residual - out.whitened_jacobian * out.change;
  out.chi2 = out.whitened_residual.squaredNorm() + prior_weight.dot((from_prior + out.change).cwiseAbs2());
  out.log_likelihood = -0.5 * (whitener.log_determinant() + out.normal.log_determinant() + out.chi2);
  return out;
}

WhiteFound estimate_white(const EffectModel& model) {
  WhiteFound found;
  Eigen::Vector3d& white = found.white;
  std::optional<WhiteFound> told;
  for (int pass = 0; pass < kWhitePasses; ++pass) {
    const AtNoise at = solve_at(model, {.white = white, .step_sd = model.step_sd()});
    // P = V^-1 - V^-1 J C J' V^-1: sums of its squared products with the noise of each output.
    ReadingRows product = at.whitened_residual;
    at.whitener->whiten_transposed(product);
    ReadingRows spread = times_upper(at.whitened_jacobian, at.normal.covariance_root());
    at.whitener->whiten_transposed(spread);
    const std::vector<NoiseAtAngle> angles = model.noise_at_angles(white);
    const std::vector<NoiseAtAngle> estimated = model.stated_noise_at_angles(white);
    Eigen::Vector3d squares = Eigen::Vector3d::Zero();
    Eigen::Vector3d& redundancy = found.redundancy;
    redundancy.setZero();
    for (std::size_t n = 0; n < angles.size(); ++n) {
      Eigen::Matrix3d v =
          model.step_sd() * model.step_sd() * angles[n].by_step * angles[n].by_step.transpose();
      v.diagonal() += angles[n].white;
      const Eigen::Matrix3d inverse = v.llt().solve(Eigen::Matrix3d::Identity());
      for (int j = 0; j < 3; ++j) {
        const auto row = static_cast<Eigen::Index>(3 * n) + j;
        squares(j) += estimated[n].white(j) * product(row, 0) * product(row, 0);
        redundancy(j) += estimated[n].white(j) * (inverse(j, j) - spread.row(row).squaredNorm());
      }
    }
    if (!(redundancy.minCoeff() >= 0.5)) {
      // Readings whose hysteresis has no known sign contain no information on a smaller noise.
      if (told) return *told;
      throw UnusableData(
          fmt::format("{} angles leave nothing to estimate the noise from; more angles or the uncertainties "
                      "of the readings are required",
                      angles.size()));
    }
    told = found;
    const Eigen::Vector3d before = white;
    white = white.cwiseProduct(squares.cwiseQuotient(redundancy).cwiseSqrt()).cwiseMax(model.least_white());
    if ((white.cwiseQuotient(before).array() - 1.0).abs().maxCoeff() < kWhiteFound) break;
  }
  return found;
}

double log_of_sum(std::span<const double> logs) {
  const double largest = *std::max_element(logs.begin(), logs.end());
  double sum = 0.0;
  for (const double one : logs) sum += std::exp(one - largest);
  return largest + std::log(sum);
}

double NoiseSearch::weight(std::size_t i) const {
  return std::exp(log_weights[i]);
}

std::size_t NoiseSearch::best() const {
  return static_cast<std::size_t>(std::max_element(log_weights.begin(), log_weights.end()) -
                                  log_weights.begin());
}

ProbableNoises probable_noises(const NoiseQuestion& question, const NoiseAnswer& at) {
  Search search(question, at);
  if (question.process) search.try_processes();
  return std::move(search).found();
}

std::vector<NoiseCandidate> noise_candidates(const NoiseQuestion& question) {
  std::vector<NoiseCandidate> out{NoiseCandidate{}};
  if (!question.process) return out;
  for (const CorrelationLength& length : kGrid)
    for (const double tau : length.tau) out.push_back({tau, length.rho, 1.0});
  if (!question.white_known) return out;
  for (const double white : kSmallerWhite) out.push_back({0.0, 1.0, white});
  for (const double tau : kTauOfStatedNoise)
    for (const double rho : kRhoOfStatedNoise) out.push_back({tau, rho, kLittleWhite});
  return out;
}

AssumedNoise assumed_noise(const EffectModel& model, const WhiteFound& white,
                           const NoiseCandidate& candidate) {
  return {candidate.tau, candidate.rho, candidate.white * white.white, model.step_sd()};
}

NoiseSearch search_noise(const EffectModel& model) {
  NoiseSearch out;
  if (!model.options().white_known) out.white = estimate_white(model);
  const NoiseQuestion question{model.options().noise_process, model.options().white_known,
                               static_cast<double>(model.residual().size())};
  std::map<NoiseCandidate, AtNoise> solved;
  double stated = 0.0;
  const ProbableNoises found = probable_noises(question, [&](const NoiseCandidate& candidate) {
    AtNoise point = solve_at(model, assumed_noise(model, out.white, candidate));
    const NoiseLikelihood likelihood{point.log_likelihood, point.chi2};
    if (solved.empty()) stated = point.log_likelihood;
    // The search leaves out those that are less likely, as their priors are below 1.
    if (solved.empty() || point.log_likelihood - stated >= std::log(kNegligibleWeight))
      solved.emplace(candidate, std::move(point));
    return likelihood;
  });
  for (const ProbableNoise& one : found.noises) {
    out.points.push_back(std::move(solved.at(one.noise)));
    out.log_weights.push_back(one.log_weight);
  }
  out.log_evidence = found.log_evidence;
  return out;
}

}  // namespace abcal
