// Procedures B and the largest consistent subset against computations by other algorithms: order statistics
// and plain enumeration in place of draws and Schur complements. The results are those of a published
// comparison of acceleration.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <optional>
#include <random>
#include <vector>

#include "app/laboratory/pilot/key_comparison.h"
#include "protocol/statistics/distributions.h"
#include "tests/app/pilot/published_comparison.h"

namespace abcal {
namespace {

using Eigen::Index;
using test::kVibration;
using test::published_comparison;
using test::univariate_results;

constexpr double kRootOfTwo = 1.4142135623730951;

/// Independent normal results of one quantity.
struct NormalResults {
  std::vector<double> x, u;

  explicit NormalResults(const ParticipantResults& results) {
    for (Index i = 0; i < results.participants(); ++i) {
      x.push_back(results.values(i));
      u.push_back(std::sqrt(results.covariance(i, i)));
    }
  }
  std::size_t size() const { return x.size(); }
  double density(std::size_t i, double at) const { return normal_density((at - x[i]) / u[i]) / u[i]; }
  double below(std::size_t i, double at) const { return 0.5 * std::erfc((x[i] - at) / (u[i] * kRootOfTwo)); }
};

/// Expectation and standard deviation of the median of an even number of normal values: the joint density of
/// the two in the middle, a <= b, is the sum over all choices of the two, with half of the others below a and
/// half above b.
struct MedianMoments {
  double probability = 0.0, mean = 0.0, standard_deviation = 0.0;
};
MedianMoments moments_of_even_median(const NormalResults& results) {
  const std::size_t half = results.size() / 2 - 1;
  const auto joint_density = [&](double a, double b) {
    // Coefficients of polynomials in the number below, with and without a value at a and at b.
    std::array<std::array<double, 16>, 4> ways{};
    ways[0][0] = 1.0;
    for (std::size_t k = 0; k < results.size(); ++k) {
      const double under = results.below(k, a), over = 1.0 - results.below(k, b);
      const double at_a = results.density(k, a), at_b = results.density(k, b);
      std::array<std::array<double, 16>, 4> next{};
      for (std::size_t marks = 0; marks < 4; ++marks)
        for (std::size_t count = 0; count <= half; ++count) {
          const double before = ways[marks][count];
          next[marks][count] += before * over;
          if (count < half) next[marks][count + 1] += before * under;
          if ((marks & 1U) == 0) next[marks | 1U][count] += before * at_a;
          if ((marks & 2U) == 0) next[marks | 2U][count] += before * at_b;
        }
      ways = next;
    }
    return ways[3][half];
  };
  // Over centre and width: trapezoids over the centre, Simpson's rule over the width.
  constexpr double kReach = 12.0, kStep = 0.05;
  constexpr int kWidths = 240;
  const double width_step = kReach / kWidths;
  MedianMoments moments;
  double square = 0.0;
  for (double centre = -kReach; centre <= kReach; centre += kStep) {
    double over_widths = 0.0;
    for (int k = 0; k <= kWidths; ++k) {
      const double width = k * width_step, weight = k == 0 || k == kWidths ? 1.0 : k % 2 == 1 ? 4.0 : 2.0;
      over_widths += weight * joint_density(centre - 0.5 * width, centre + 0.5 * width);
    }
    const double part = over_widths * width_step / 3.0 * kStep;
    moments.probability += part;
    moments.mean += part * centre;
    square += part * centre * centre;
  }
  moments.standard_deviation = std::sqrt(square - moments.mean * moments.mean);
  return moments;
}

/// P(D <= d) of D = x_i - median of an odd number of normal values, x_i one of them: the median is at least m
/// if at most half of them are below m.
double difference_below(const NormalResults& results, std::size_t i, double d) {
  const std::size_t half = results.size() / 2;
  const auto at_most_half_below = [&](double m, bool itself_below) {
    std::vector<double> ways(results.size() + 1, 0.0);
    ways[itself_below ? 1 : 0] = 1.0;
    for (std::size_t k = 0; k < results.size(); ++k) {
      if (k == i) continue;
      const double under = results.below(k, m);
      for (std::size_t count = ways.size() - 1; count > 0; --count)
        ways[count] = ways[count] * (1.0 - under) + ways[count - 1] * under;
      ways[0] *= 1.0 - under;
    }
    double sum = 0.0;
    for (std::size_t count = 0; count <= half; ++count) sum += ways[count];
    return sum;
  };
  constexpr int kSteps = 160;
  constexpr double kReach = 8.0;
  double sum = 0.0;
  for (int k = 0; k <= kSteps; ++k) {
    const double z = kReach * (2.0 * k / kSteps - 1.0);
    sum += normal_density(z) * 2.0 * kReach / kSteps *
           at_most_half_below(results.x[i] + results.u[i] * z - d, d < 0.0);
  }
  return sum;
}

/// Half the shortest interval that holds 95 % of D.
double exact_expanded(const NormalResults& results, std::size_t i) {
  // The distribution on a grid, then by interpolation.
  constexpr int kPoints = 4800;
  const double reach = 6.0 * results.u[i] + 8.0;
  std::vector<double> at, below;
  for (int k = 0; k <= kPoints; ++k) {
    at.push_back(results.x[i] + reach * (2.0 * k / kPoints - 1.0));
    below.push_back(difference_below(results, i, at.back()));
  }
  double shortest = 2.0 * reach;
  for (std::size_t k = 0; k < at.size(); ++k) {
    const auto end = std::ranges::lower_bound(below, below[k] + 0.95);
    if (end == below.end() || end == below.begin()) break;
    const auto upper = static_cast<std::size_t>(end - below.begin());
    const double part = (below[k] + 0.95 - below[upper - 1]) / (below[upper] - below[upper - 1]);
    shortest = std::min(shortest, at[upper - 1] + part * (at[upper] - at[upper - 1]) - at[k]);
  }
  return 0.5 * shortest;
}

TEST(Procedures, MedianOfThePublishedComparisonByOrderStatistics) {
  const ParticipantResults results = published_comparison();
  const MedianMoments exact = moments_of_even_median(NormalResults(results));
  ASSERT_NEAR(exact.probability, 1.0, 1e-6);
  constexpr int kDraws = 400'000;
  const ReferenceValue reference =
      reference_value(results, {.procedure = ReferenceProcedure::kMedian, .draws = kDraws});
  // Four standard deviations of a mean and of a standard deviation from so many draws.
  const double of_mean = exact.standard_deviation / std::sqrt(kDraws);
  EXPECT_NEAR(reference.values(0), exact.mean, 4.0 * of_mean);
  EXPECT_NEAR(std::sqrt(reference.covariance(0, 0)), exact.standard_deviation, 4.0 * of_mean / kRootOfTwo);
}

TEST(Procedures, ExpandedUncertaintiesOfTheMedianByOrderStatistics) {
  // An odd number: the published comparison without its last institute.
  const ParticipantResults all = published_comparison();
  const Index n = all.participants() - 1;
  const ParticipantResults results{.quantities = 1,
                                   .values = all.values.head(n),
                                   .covariance = all.covariance.topLeftCorner(n, n),
                                   .coverage_factors = std::vector<double>(static_cast<std::size_t>(n), 2.0)};
  const NormalResults normal(results);
  const ReferenceValue reference =
      reference_value(results, {.procedure = ReferenceProcedure::kMedian, .draws = 400'000});
  for (Index i = 0; i < n; ++i) {
    // A 2.5 % quantile of 400 000 draws of a normal value scatters by 0.4 % of U, half an interval by 0.3 %.
    const double exact = exact_expanded(normal, static_cast<std::size_t>(i));
    EXPECT_NEAR(reference.expanded(i), exact, 0.012 * exact)
        << kVibration[static_cast<std::size_t>(i)].institute;
  }
}

/// The largest consistent subset by trying every set of results.
struct EnumeratedSubset {
  unsigned members = 0;
  double chi2 = 0.0, mean = 0.0, u = 0.0;
  int alternatives = 0;
};
std::optional<EnumeratedSubset> enumerated_subset(const NormalResults& results, double level) {
  std::optional<EnumeratedSubset> best;
  for (unsigned members = 1; members < 1U << results.size(); ++members) {
    const int count = std::popcount(members);
    if (2 * count <= static_cast<int>(results.size())) continue;
    double weights = 0.0, sum = 0.0, chi2 = 0.0;
    for (std::size_t i = 0; i < results.size(); ++i)
      if ((members >> i & 1U) != 0) {
        weights += 1.0 / (results.u[i] * results.u[i]);
        sum += results.x[i] / (results.u[i] * results.u[i]);
      }
    for (std::size_t i = 0; i < results.size(); ++i)
      if ((members >> i & 1U) != 0) chi2 += std::pow((results.x[i] - sum / weights) / results.u[i], 2);
    if (chi2 > chi2_quantile(1.0 - level, count - 1)) continue;
    const int size_of_best = best ? std::popcount(best->members) : 0;
    if (count < size_of_best) continue;
    const int alternatives = count == size_of_best ? best->alternatives + 1 : 0;
    if (count > size_of_best || chi2 < best->chi2)
      best = {members, chi2, sum / weights, 1.0 / std::sqrt(weights), alternatives};
    best->alternatives = alternatives;
  }
  return best;
}

TEST(Procedures, LargestConsistentSubsetByEnumeration) {
  const ParticipantResults published = published_comparison();
  std::mt19937_64 engine(17);
  std::normal_distribution<double> normal;
  int without_majority = 0, smaller = 0;
  for (int trial = 0; trial < 200; ++trial) {
    // The institutes' uncertainties, and errors that are larger.
    ParticipantResults results = published;
    const double excess = trial == 0 ? 0.0 : 1.0 + 0.02 * trial;
    for (Index i = 0; i < results.participants(); ++i)
      results.values(i) += excess * std::sqrt(results.covariance(i, i)) * normal(engine);
    const std::optional<EnumeratedSubset> expected = enumerated_subset(NormalResults(results), 0.05);
    const ReferenceOptions options{.procedure = ReferenceProcedure::kSubset};
    if (!expected) {
      ++without_majority;
      EXPECT_THROW(reference_value(results, options), KeyComparisonError);
      continue;
    }
    const ReferenceValue reference = reference_value(results, options);
    for (Index i = 0; i < results.participants(); ++i)
      EXPECT_EQ(reference.contributes(i, 0), static_cast<int>(expected->members >> i & 1U)) << trial;
    EXPECT_NEAR(reference.values(0), expected->mean, 1e-9);
    EXPECT_NEAR(std::sqrt(reference.covariance(0, 0)), expected->u, 1e-9);
    EXPECT_EQ(reference.alternatives, expected->alternatives) << trial;
    if (reference.contributes.sum() < results.participants()) ++smaller;
  }
  EXPECT_GT(smaller, 100) << "the trials must leave institutes out";
  EXPECT_GT(without_majority, 0);
}

}  // namespace
}  // namespace abcal
