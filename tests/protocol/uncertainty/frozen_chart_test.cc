#include "protocol/uncertainty/frozen_chart.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <stdexcept>
#include <vector>

#include "protocol/statistics/distributions.h"
#include "protocol/uncertainty/run_length.h"

namespace abcal {
namespace {

/// Half of the last digit of a number printed with this number of decimals.
double half_digit(int decimals) {
  return 0.5001 * std::pow(10.0, -decimals);
}

TEST(RunLengthTest, SingleValuesAreThoseOfTheNormalDistribution) {
  EXPECT_NEAR(shewhart_run_length(3.0), 370.4, half_digit(1));
  EXPECT_NEAR(shewhart_run_length(3.0, {1.0, 1.0}), 43.9, half_digit(1));  // ISO 7870-2
  EXPECT_NEAR(shewhart_run_length(3.0, {-1.0, 1.0}), 43.9, half_digit(1));
  EXPECT_NEAR(shewhart_run_length(3.0, {0.0, 2.0}), 1.0 / 0.133614, 0.001);
}

// Lucas and Saccucci, Technometrics 32 (1990), table 3, as Montgomery, Introduction to statistical quality
// control, table 9.11, prints them: weight 0.4, 0.25, 0.2, 0.1, 0.05.
TEST(RunLengthTest, MovingAveragesAgreeWithThePublishedTable) {
  struct Row {
    double shift;
    std::array<double, 5> length;
    int decimals;
  };
  constexpr std::array<double, 5> kWeights{0.4, 0.25, 0.2, 0.1, 0.05};
  constexpr std::array<double, 5> kLimits{3.054, 2.998, 2.962, 2.814, 2.615};
  // At weight 0.25 and shift 0.5 the book prints 48.2. The integral equation gives 48.29 with 30, 50 and 60
  // nodes and the chain of Brook and Evans 48.28 with 101 states: that number is left out.
  const double nan = std::nan("");
  const std::array<Row, 5> rows{{{0.5, {71.2, nan, 41.8, 31.3, 28.8}, 1},
                                 {1.0, {14.3, 11.1, 10.5, 10.3, 11.4}, 1},
                                 {1.5, {5.9, 5.5, 5.5, 6.1, 7.1}, 1},
                                 {2.0, {3.5, 3.6, 3.7, 4.4, 5.2}, 1},
                                 {3.0, {2.0, 2.3, 2.4, 2.9, 3.5}, 1}}};
  for (std::size_t k = 0; k < kWeights.size(); ++k) {
    // Half of the last digit of the limit, 0.0005, is 0.8 of the run length.
    EXPECT_NEAR(ewma_run_length(kWeights[k], kLimits[k]), 500.0, 0.8);
    for (const Row& row : rows)
      if (std::isfinite(row.length[k])) {
        EXPECT_NEAR(ewma_run_length(kWeights[k], kLimits[k], {row.shift, 1.0}), row.length[k],
                    half_digit(row.decimals))
            << kWeights[k] << " " << row.shift;
      }
  }
}

// Allowance 1/2, interval 4 and 5: Montgomery, table 9.3, after Siegmund, Lucas and Crosier.
TEST(RunLengthTest, CumulativeSumsAgreeWithThePublishedTable) {
  struct Row {
    double shift, at_4, at_5;
    int decimals_4, decimals_5;
  };
  const std::array<Row, 9> rows{{{0.0, 168, 465, 0, 0},
                                 {0.25, 74.2, 139, 1, 0},
                                 {0.5, 26.6, 38.0, 1, 1},
                                 {0.75, 13.3, 17.0, 1, 1},
                                 {1.0, 8.38, 10.4, 2, 1},
                                 {1.5, 4.75, 5.75, 2, 2},
                                 {2.0, 3.34, 4.01, 2, 2},
                                 {2.5, 2.62, 3.11, 2, 2},
                                 {3.0, 2.19, 2.57, 2, 2}}};
  for (const Row& row : rows) {
    EXPECT_NEAR(cusum_run_length(0.5, 4.0, {row.shift, 1.0}), row.at_4, half_digit(row.decimals_4))
        << row.shift;
    EXPECT_NEAR(cusum_run_length(0.5, 5.0, {row.shift, 1.0}), row.at_5, half_digit(row.decimals_5))
        << row.shift;
  }
}

// Independent of the chains: values are drawn and judged one by one until one is outside.
TEST(RunLengthTest, DrawnChartsLastAsLongAsTheChainsSay) {
  std::mt19937_64 engine(20260301);
  std::normal_distribution<double> normal;
  const ChartRules only_shewhart{2.2, 0.2, 1e9, 0.5, 1e9}, only_ewma{1e9, 0.2, 2.2, 0.5, 1e9},
      only_cusum{1e9, 0.2, 1e9, 0.5, 3.0};
  for (const ChartedProcess process : {ChartedProcess{0.0, 1.0}, {0.3, 1.2}, {-0.5, 0.8}}) {
    const auto drawn = [&](const ChartRules& rules) {
      constexpr int kCharts = 6000;
      double sum = 0.0;
      for (int chart = 0; chart < kCharts; ++chart) {
        ChartState state;
        do {
          sum += 1.0;
        } while (!judge(rules, process.shift + process.spread * normal(engine), state).outside());
      }
      return sum / kCharts;
    };
    // Lengths are spread nearly as an exponential distribution: 1/sqrt(6000) = 1.3 % each, at 4 standard
    // deviations.
    constexpr double kRelative = 4.0 / 77.0;
    EXPECT_NEAR(drawn(only_shewhart) / shewhart_run_length(2.2, process), 1.0, kRelative);
    EXPECT_NEAR(drawn(only_ewma) / ewma_run_length(0.2, 2.2, process), 1.0, kRelative);
    EXPECT_NEAR(drawn(only_cusum) / cusum_run_length(0.5, 3.0, process), 1.0, kRelative);
  }
}

TEST(FrozenChartTest, TheRunLengthIsReachedByTheWantedShareOfBaselines) {
  const ChartDemand demand{8, 27, 200.0, 0.9};
  const ChartRules rules = design_rules(demand);
  std::mt19937_64 engine(7);
  std::normal_distribution<double> normal;
  constexpr int kBaselines = 400;
  std::array<int, 3> reached{};
  for (int b = 0; b < kBaselines; ++b) {
    double sum = 0.0, squares = 0.0;
    for (int i = 0; i < demand.baseline_runs; ++i) {
      const double x = normal(engine);
      sum += x;
      squares += x * x;
    }
    const double mean = sum / demand.baseline_runs;
    const double s = std::sqrt((squares - sum * mean) / (demand.baseline_runs - 1));
    const ChartedProcess process{-mean / s, 1.0 / s};
    const double each = demand.run_length * demand.rules;
    reached[0] += shewhart_run_length(rules.shewhart, process) >= each ? 1 : 0;
    reached[1] += ewma_run_length(rules.ewma_weight, rules.ewma, process) >= each ? 1 : 0;
    reached[2] += cusum_run_length(rules.cusum_allowance, rules.cusum, process) >= each ? 1 : 0;
  }
  // 360 of 400, with a standard deviation of 6 and the steps of the quantiles (1 in 72).
  for (const int count : reached) EXPECT_NEAR(count, 360, 4 * 6);
}

TEST(FrozenChartTest, MoreRunsInTheBaselineGiveNarrowerLimits) {
  const ChartRules few = design_rules({6, 27, 200.0, 0.9}), many = design_rules({100, 27, 200.0, 0.9});
  EXPECT_GT(few.shewhart, many.shewhart);
  EXPECT_GT(few.ewma, many.ewma);
  EXPECT_GT(few.cusum, many.cusum);
  // Without errors of the baseline: 1 in 5400 outside.
  EXPECT_GT(many.shewhart, 3.73);
  EXPECT_GE(false_alarm_run_length(many) * 9.0, 200.0 * 9.0);
  EXPECT_LT(detection_run_length(few, 20.0), 1.01);
  EXPECT_LT(detection_run_length(many, 1.0), detection_run_length(few, 1.0));
}

// Six means and twelve standard deviations represent the baselines: of the 72 run lengths in their order the
// eighth is the one that nine tenths reach.
TEST(FrozenChartTest, TheLimitOfSingleValuesIsThatOfTheEighthOf72Baselines) {
  constexpr int kRuns = 8;
  constexpr double kEach = 27 * 200.0;
  const ChartRules rules = design_rules({kRuns, 27, 200.0, 0.9});
  const auto eighth_at = [](double limit) {
    std::vector<double> lengths;
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 12; ++j) {
        const double off = normal_quantile(0.5 + (i + 0.5) / 12.0) / std::sqrt(8.0);
        const double sd = std::sqrt(chi2_quantile((j + 0.5) / 12.0, 7.0) / 7.0);
        lengths.push_back(1.0 / (normal_tail(limit * sd + off) + normal_tail(limit * sd - off)));
      }
    std::ranges::sort(lengths);
    return lengths[7];
  };
  EXPECT_GE(eighth_at(rules.shewhart), kEach);
  EXPECT_LT(eighth_at(rules.shewhart - 1.01e-5), kEach);
  EXPECT_NEAR(rules.cusum_allowance, 0.5 + 1.894579 / std::sqrt(8.0), 1e-6);  // t of 7 degrees, 95 %
  const double alarms = 1.0 / shewhart_run_length(rules.shewhart) + 1.0 / ewma_run_length(0.2, rules.ewma) +
                        1.0 / cusum_run_length(rules.cusum_allowance, rules.cusum);
  EXPECT_NEAR(false_alarm_run_length(rules) * alarms, 1.0, 1e-12);
}

TEST(FrozenChartTest, AValueOnALimitIsInside) {
  ChartRules rules{4.0, 0.25, 1e9, 0.5, 1e9};
  const auto is_outside = [&](double z) {
    ChartState state;
    return judge(rules, z, state).outside();
  };
  for (const double sign : {-1.0, 1.0}) {
    rules = {4.0, 0.25, 1e9, 0.5, 1e9};
    EXPECT_FALSE(is_outside(sign * 4.0));
    EXPECT_TRUE(is_outside(sign * std::nextafter(4.0, 5.0)));
    rules = {1e9, 0.25, 1e9, 0.5, 5.0};
    EXPECT_FALSE(is_outside(sign * 5.5));
    EXPECT_TRUE(is_outside(sign * 5.5001));
    rules = {1e9, 0.25, 3.0, 0.5, 1e9};  // A quarter of the value, within 3 sqrt(0.25 / 1.75).
    EXPECT_FALSE(is_outside(sign * 4.0 * 1.1338934));
    EXPECT_TRUE(is_outside(sign * 4.0 * 1.1338935));
  }
}

TEST(FrozenChartTest, JudgesByEachRule) {
  const ChartRules rules{4.0, 0.2, 3.0, 0.5, 5.0};
  ChartState state;
  EXPECT_EQ(judge(rules, 4.5, state).broken(), "single value");
  state = {};
  JudgedValue last;
  for (int i = 0; i < 6; ++i) last = judge(rules, -2.0, state);
  EXPECT_EQ(last.broken(), "moving average, cumulative sum");
  EXPECT_DOUBLE_EQ(last.cusum_low, 9.0);
  EXPECT_DOUBLE_EQ(last.cusum_high, 0.0);
  state = {};
  EXPECT_FALSE(judge(rules, 1.0, state).outside());
  EXPECT_TRUE(judge(rules, std::nan(""), state).outside());  // An unknown value is not inside.
}

// Critical values of Grubbs' test, two-sided 5 % (one-sided 2.5 %): Grubbs and Beck, Technometrics 14 (1972).
TEST(FrozenChartTest, OutliersAreThoseOfThePublishedTable) {
  EXPECT_NEAR(outlier_limit(5, 0.05), 1.715, half_digit(3));
  EXPECT_NEAR(outlier_limit(10, 0.05), 2.290, half_digit(3));
  EXPECT_NEAR(outlier_limit(20, 0.05), 2.709, 0.001);
  // Student's t of one degree of freedom is a cotangent.
  EXPECT_NEAR(outlier_limit(3, 0.05), 2.0 / std::sqrt(3.0) * std::cos(std::numbers::pi / 120.0), 1e-9);
  EXPECT_THROW(outlier_limit(2, 0.05), std::invalid_argument);
  EXPECT_THROW(outlier_limit(5, 0.0), std::invalid_argument);
  EXPECT_THROW(outlier_limit(5, 1.0), std::invalid_argument);
}

TEST(FrozenChartTest, RefusesWhatItCannotPromise) {
  EXPECT_THROW(design_rules({2, 27, 200.0, 0.9}), std::invalid_argument);
  EXPECT_NO_THROW(design_rules({3, 1, 1.5, 0.5}));
  EXPECT_THROW(design_rules({8, 0, 200.0, 0.9}), std::invalid_argument);
  EXPECT_THROW(design_rules({8, 27, 1.0, 0.9}), std::invalid_argument);
  EXPECT_THROW(design_rules({8, 27, 200.0, 0.0}), std::invalid_argument);
  EXPECT_THROW(design_rules({8, 27, 200.0, 1.0}), std::invalid_argument);
  EXPECT_THROW(ewma_run_length(0.0, 3.0), std::invalid_argument);
  EXPECT_THROW(shewhart_run_length(3.0, {0.0, 0.0}), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
