#include "protocol/uncertainty/coverage.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "protocol/statistics/distributions.h"
#include "protocol/uncertainty/gum_validation.h"
#include "protocol/uncertainty/random_stream.h"

namespace abcal {
namespace {

TEST(CoverageTest, PicksTheRanksOfJcgm101) {
  std::vector<double> values(1000);
  std::iota(values.begin(), values.end(), 1.0);  // y_(r) = r
  const Coverage coverage = coverage_of_sorted(values, 0.95);
  // q = 950, (M - q)/2 = 25.
  EXPECT_EQ(coverage.symmetric.low, 25.0);
  EXPECT_EQ(coverage.symmetric.high, 975.0);
  EXPECT_EQ(coverage.shortest.low, 1.0);
  EXPECT_EQ(coverage.shortest.high, 951.0);
}

TEST(CoverageTest, TheShortestIntervalOfASkewedDistributionLiesWhereItIsDense) {
  // Exponential distribution: the shortest 95 % interval begins at 0 and ends at ln 20.
  std::vector<double> values;
  constexpr int kN = 100'000;
  for (int i = 0; i < kN; ++i) values.push_back(-std::log((i + 0.5) / kN));
  std::sort(values.begin(), values.end());
  const Coverage coverage = coverage_of_sorted(values, 0.95);
  EXPECT_NEAR(coverage.shortest.low, 0.0, 1e-4);
  EXPECT_NEAR(coverage.shortest.high, std::log(20.0), 1e-3);
  EXPECT_NEAR(coverage.symmetric.low, -std::log(0.975), 1e-4);
  EXPECT_NEAR(coverage.symmetric.high, -std::log(0.025), 1e-3);
}

TEST(CoverageTest, UnsortedValuesGiveTheSame) {
  RandomStream stream(5, StreamPurpose::kTest, 0);
  for (const double p : {0.3, 0.5, 0.6, 0.9, 0.95, 0.99}) {
    for (const int n : {100, 101, 997, 5000, 40'000}) {
      std::vector<double> values;
      for (int i = 0; i < n; ++i) values.push_back(std::exp(stream.normal()));
      std::vector<double> sorted = values;
      std::sort(sorted.begin(), sorted.end());
      const Coverage expected = coverage_of_sorted(sorted, p), found = coverage_of(values, p);
      EXPECT_EQ(found.symmetric.low, expected.symmetric.low) << p << " " << n;
      EXPECT_EQ(found.symmetric.high, expected.symmetric.high) << p << " " << n;
      EXPECT_EQ(found.shortest.low, expected.shortest.low) << p << " " << n;
      EXPECT_EQ(found.shortest.high, expected.shortest.high) << p << " " << n;
    }
  }
}

// The tails are found by a sample of the values: one that is not like the whole must not matter.
TEST(CoverageTest, ValuesInAnOrderThatMisleadsASampleGiveTheSame) {
  constexpr std::size_t kCount = 40'000;
  for (const std::size_t period : {1U, 2U, 10U, 100U}) {
    std::vector<double> values(kCount);
    for (std::size_t i = 0; i < kCount; ++i)
      values[i] = i % period == 0 ? 1e6 + static_cast<double>(i) : std::sin(static_cast<double>(i));
    std::vector<double> sorted = values;
    std::sort(sorted.begin(), sorted.end());
    const Coverage expected = coverage_of_sorted(sorted, 0.95), found = coverage_of(values, 0.95);
    EXPECT_EQ(found.symmetric.low, expected.symmetric.low) << period;
    EXPECT_EQ(found.symmetric.high, expected.symmetric.high) << period;
    EXPECT_EQ(found.shortest.low, expected.shortest.low) << period;
    EXPECT_EQ(found.shortest.high, expected.shortest.high) << period;
  }
  std::vector<double> same(kCount, 3.0);
  EXPECT_EQ(coverage_of(same, 0.95).shortest.high, 3.0);
}

TEST(CoverageTest, RefusesWhatCannotBeAnswered) {
  const std::vector<double> values = {1.0, 2.0, 3.0};
  EXPECT_THROW(coverage_of_sorted(values, 0.99), std::invalid_argument);
  EXPECT_THROW(coverage_of_sorted(values, 1.0), std::invalid_argument);
  EXPECT_THROW(coverage_of_sorted(values, std::nan("")), std::invalid_argument);
}

TEST(GridHistogramTest, AgreesWithTheSortedValuesToABin) {
  RandomStream stream(4, StreamPurpose::kTest, 0);
  std::vector<double> values;
  GridHistogram whole(3.0, 2.0), half(3.0, 2.0), other_half(3.0, 2.0);
  for (int i = 0; i < 100'000; ++i) {
    values.push_back(3.0 + 2.0 * stream.normal());
    whole.add(values.back());
    (i % 2 == 0 ? half : other_half).add(values.back());
  }
  half.add(other_half);
  std::sort(values.begin(), values.end());
  const Coverage exact = coverage_of_sorted(values, 0.95);
  const Coverage grid = whole.coverage(0.95);
  EXPECT_NEAR(grid.symmetric.low, exact.symmetric.low, whole.bin_width());
  EXPECT_NEAR(grid.symmetric.high, exact.symmetric.high, whole.bin_width());
  EXPECT_NEAR(grid.shortest.high - grid.shortest.low, exact.shortest.high - exact.shortest.low,
              2.0 * whole.bin_width());
  const Coverage merged = half.coverage(0.95);
  EXPECT_EQ(merged.symmetric.low, grid.symmetric.low);
  EXPECT_EQ(merged.shortest.high, grid.shortest.high);
  EXPECT_THROW(half.add(GridHistogram(0.0, 2.0)), std::invalid_argument);
}

TEST(GridHistogramTest, AnOutputThatDoesNotVaryHasAnIntervalOfNoLength) {
  GridHistogram histogram(1.5, 0.0);
  for (int i = 0; i < 1000; ++i) histogram.add(1.5);
  EXPECT_EQ(histogram.coverage(0.95).symmetric.low, 1.5);
  EXPECT_EQ(histogram.coverage(0.95).symmetric.high, 1.5);
}

TEST(GumValidationTest, NormalQuantilesAreTheTabulatedOnes) {
  EXPECT_NEAR(normal_quantile(0.975), 1.959963984540054, 4e-15);  // a few ulp
  EXPECT_NEAR(normal_quantile(0.025), -1.959963984540054, 4e-15);
  EXPECT_NEAR(normal_quantile(0.5), 0.0, 4e-16);
  EXPECT_NEAR(normal_quantile(0.995), 2.575829303548901, 4e-15);
}

}  // namespace
}  // namespace abcal
