#include "protocol/uncertainty/analysis_of_variance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace abcal {
namespace {

using Groups = std::vector<std::vector<double>>;

// NIST Statistical Reference Datasets, one-way analysis of variance, "SiRstv" (resistivity of silicon, five
// instruments), with its certified values.
TEST(OneWayAnovaTest, AgreesWithTheCertifiedValuesOfSiRstv) {
  const Groups groups{{196.3052, 196.1240, 196.1890, 196.2569, 196.3403},
                      {196.3042, 196.3825, 196.1669, 196.3257, 196.0422},
                      {196.1303, 196.2005, 196.2889, 196.0343, 196.1811},
                      {196.2795, 196.1748, 196.1494, 196.1485, 195.9885},
                      {196.2119, 196.1051, 196.1850, 196.0052, 196.2090}};
  const OneWayAnova anova = one_way_anova(groups);
  EXPECT_EQ(anova.between_degrees_of_freedom, 4);
  EXPECT_EQ(anova.within_degrees_of_freedom, 20);
  // Values near 196 with a spread of 0.1: ten digits is what double precision leaves.
  EXPECT_NEAR(anova.between_sum_squares / 5.11462616000000e-02, 1.0, 1e-10);
  EXPECT_NEAR(anova.within_sum_squares / 2.16636560000000e-01, 1.0, 1e-10);
  EXPECT_NEAR(anova.f / 1.18046237440255, 1.0, 1e-10);
  EXPECT_NEAR(anova.repeatability / 1.04076068334656e-01, 1.0, 1e-10);
  EXPECT_NEAR(anova.f_probability, 0.3494474935, 2e-9);  // incomplete beta function by Simpson's rule
  // (51.146/4 - 216.637/20)/5 in units of 1e-3, by hand.
  EXPECT_NEAR(anova.between, std::sqrt((1.27865654e-02 - 1.08318280e-02) / 5.0), 1e-11);
}

// JCGM 100:2008, H.5: ten days of five observations of a Zener reference, of which the guide prints the mean
// and the standard deviation of each day (microvolts above 10 V).
TEST(OneWayAnovaTest, AgreesWithTheZenerReferenceOfTheGum) {
  const std::array<double, 10> means{172, 116, 13, 144, 106, 31, 60, 125, 163, 41};
  const std::array<double, 10> deviations{60, 77, 111, 101, 67, 93, 80, 73, 88, 86};
  // Five numbers with mean 0 and standard deviation 1.
  const double a = std::sqrt(0.4);
  Groups groups;
  for (std::size_t day = 0; day < 10; ++day) {
    std::vector<double> group;
    for (const double x : {-2.0 * a, -a, 0.0, a, 2.0 * a}) group.push_back(means[day] + deviations[day] * x);
    groups.push_back(group);
  }
  const OneWayAnova anova = one_way_anova(groups);
  EXPECT_NEAR(anova.mean, 97.1, 1e-9);                                         // printed 10.000 097 V
  EXPECT_NEAR(std::sqrt(anova.between_mean_square()), 128.0, 0.5);             // s_a
  EXPECT_NEAR(anova.repeatability, 85.0, 0.5);                                 // s_b
  EXPECT_NEAR(anova.f, 2.25, 0.03);                                            // printed (128/85)^2
  EXPECT_NEAR(anova.between, 43.0, 0.5);                                       // s_B
  EXPECT_NEAR(anova.mean_standard_uncertainty, 18.0, 0.5);                     // u of the mean
  EXPECT_NEAR(anova.reproducibility, std::hypot(84.886984, 42.638611), 1e-5);  // from the same, by hand
  EXPECT_NEAR(anova.f_probability, 0.0373968, 1e-6);  // between the 2.5 % and 5 % points that the guide names
}

TEST(OneWayAnovaTest, GroupsThatDoNotDifferArePooled) {
  // Means 2, 2, 2: nothing between; s_r^2 = (2 + 2 + 2)/6; all nine as one kind: 6/8, over 9.
  const Groups groups{{1, 2, 3}, {1, 2, 3}, {3, 2, 1}};
  const OneWayAnova anova = one_way_anova(groups);
  EXPECT_EQ(anova.f, 0.0);
  EXPECT_EQ(anova.f_probability, 1.0);
  EXPECT_EQ(anova.between, 0.0);
  EXPECT_DOUBLE_EQ(anova.repeatability, 1.0);
  EXPECT_DOUBLE_EQ(anova.mean_standard_uncertainty, std::sqrt(6.0 / 8.0 / 9.0));
}

TEST(OneWayAnovaTest, TakesGroupsOfDifferentSize) {
  // By hand: sizes 2, 3, 1; means 1, 5, 9; grand mean 26/6; SSW = 2 + 2 = 4 (3 degrees of freedom),
  // SSB = 2 (10/3)^2 + 3 (2/3)^2 + (14/3)^2 = 136/3 (2); n0 = (6 - 14/6)/2 = 11/6.
  const Groups groups{{0, 2}, {4, 5, 6}, {9}};
  const OneWayAnova anova = one_way_anova(groups);
  EXPECT_NEAR(anova.mean, 26.0 / 6.0, 1e-14);
  EXPECT_NEAR(anova.within_sum_squares, 4.0, 1e-13);
  EXPECT_NEAR(anova.between_sum_squares, 136.0 / 3.0, 1e-12);
  EXPECT_NEAR(anova.f, (68.0 / 3.0) / (4.0 / 3.0), 1e-12);
  const double between = (68.0 / 3.0 - 4.0 / 3.0) / (11.0 / 6.0);
  EXPECT_NEAR(anova.between, std::sqrt(between), 1e-12);
  EXPECT_NEAR(anova.mean_standard_uncertainty, std::sqrt(between * 14.0 / 36.0 + 4.0 / 3.0 / 6.0), 1e-12);
}

TEST(OneWayAnovaTest, EqualValuesWithinGroupsGiveAnInfiniteRatio) {
  const OneWayAnova apart = one_way_anova(Groups{{1, 1}, {2, 2}});
  EXPECT_TRUE(std::isinf(apart.f));
  EXPECT_EQ(apart.f_probability, 0.0);
  const OneWayAnova same = one_way_anova(Groups{{1, 1}, {1, 1}});
  EXPECT_EQ(same.f_probability, 1.0);
  EXPECT_EQ(same.reproducibility, 0.0);
}

TEST(OneWayAnovaTest, RefusesWhatTellsNothing) {
  EXPECT_THROW(one_way_anova(Groups{{1, 2, 3}}), std::invalid_argument);
  EXPECT_THROW(one_way_anova(Groups{{1, 2}, {}}), std::invalid_argument);
  EXPECT_THROW(one_way_anova(Groups{{1}, {2}, {3}}), std::invalid_argument);
  EXPECT_THROW(one_way_anova(Groups{{1, 2}, {3, std::numeric_limits<double>::quiet_NaN()}}),
               std::invalid_argument);
}

TEST(RunSpreadTest, SeparatesTheScatterBetweenRunsFromTypeA) {
  // By hand: values 1, 2, 3, 6 with u = 1: mean 3, s^2 = 14/3, between^2 = 11/3, chi2 = 14 with 3 degrees of
  // freedom, whose tail is erfc(sqrt(7)) + sqrt(28/pi) exp(-7).
  const std::array<double, 4> values{1, 2, 3, 6};
  const std::array<double, 4> type_a{1, 1, 1, 1};
  const RunSpread spread = spread_between_runs(values, type_a);
  EXPECT_DOUBLE_EQ(spread.mean, 3.0);
  EXPECT_NEAR(spread.standard_deviation, std::sqrt(14.0 / 3.0), 1e-14);
  EXPECT_NEAR(spread.between, std::sqrt(11.0 / 3.0), 1e-14);
  EXPECT_NEAR(spread.mean_standard_uncertainty, std::sqrt(14.0 / 3.0 / 4.0), 1e-14);
  EXPECT_NEAR(spread.chi2, 14.0, 1e-13);
  const double pi = std::acos(-1.0);
  EXPECT_NEAR(spread.chi2_probability, std::erfc(std::sqrt(7.0)) + std::sqrt(28.0 / pi) * std::exp(-7.0),
              1e-12);
}

TEST(RunSpreadTest, ScatterThatTypeAExplainsIsNotCountedTwice) {
  const std::array<double, 3> values{1.0, 1.1, 0.9};
  const std::array<double, 3> type_a{0.3, 0.4, 0.5};
  const RunSpread spread = spread_between_runs(values, type_a);
  EXPECT_EQ(spread.between, 0.0);
  EXPECT_NEAR(spread.within, std::sqrt(0.5 / 3.0), 1e-14);
  EXPECT_NEAR(spread.mean_standard_uncertainty, std::sqrt(0.5 / 9.0), 1e-14);
  // Weights 1/0.09, 1/0.16, 1/0.25: weighted mean 1.0086..., by hand.
  const double weights = 1 / 0.09 + 1 / 0.16 + 1 / 0.25;
  const double mean = (1.0 / 0.09 + 1.1 / 0.16 + 0.9 / 0.25) / weights;
  EXPECT_NEAR(
      spread.chi2,
      std::pow((1.0 - mean) / 0.3, 2) + std::pow((1.1 - mean) / 0.4, 2) + std::pow((0.9 - mean) / 0.5, 2),
      1e-12);
}

TEST(RunSpreadTest, RefusesWhatTellsNothing) {
  const std::array<double, 2> two{1, 2};
  const std::array<double, 1> one{1};
  const std::array<double, 2> zero{1, 0};
  EXPECT_THROW(spread_between_runs(one, one), std::invalid_argument);
  EXPECT_THROW(spread_between_runs(two, one), std::invalid_argument);
  EXPECT_THROW(spread_between_runs(two, zero), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
