#include "protocol/uncertainty/control_chart.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <stdexcept>

namespace abcal {
namespace {

// NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2: flow rates of ten batches.
constexpr std::array<double, 10> kFlowRates{49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1};

TEST(ControlChartTest, IndividualsAgreeWithTheHandbook) {
  const ControlChart chart = individuals_chart(kFlowRates);
  ASSERT_EQ(chart.points.size(), 10U);
  EXPECT_NEAR(chart.centre, 50.81, 1e-12);
  EXPECT_NEAR(chart.standard_deviation * 1.128, 1.8778, 0.00005);  // mean moving range
  EXPECT_NEAR(chart.points.front().upper, 55.8041, 0.00005);
  EXPECT_NEAR(chart.points.front().lower, 45.8159, 0.00005);
  EXPECT_TRUE(chart.in_control());
}

// NIST/SEMATECH e-Handbook, 6.3.2.4: lambda 0.3 and limits from history, 50 and s = 2.0539.
TEST(ControlChartTest, MovingAverageAgreesWithTheHandbook) {
  const std::array<double, 20> values{52.0, 47.0, 53.0, 49.3, 50.1, 47.0, 51.0, 50.1, 51.2, 50.5,
                                      49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1};
  const std::array<double, 20> printed{50.60, 49.52, 50.56, 50.18, 50.16, 49.21, 49.75, 49.85, 50.26, 50.33,
                                       50.11, 49.36, 49.52, 50.05, 49.38, 49.92, 50.73, 51.23, 51.94, 51.99};
  const ControlChart chart = ewma_chart(values, 50.0, 2.0539, 0.3);
  ASSERT_EQ(chart.points.size(), printed.size());
  for (std::size_t i = 0; i < printed.size(); ++i) EXPECT_NEAR(chart.points[i].value, printed[i], 0.005) << i;
  EXPECT_NEAR(chart.points.back().upper, 52.5884, 0.0005);  // the lasting limits
  EXPECT_NEAR(chart.points.back().lower, 47.4115, 0.0005);
  // The first average varies as 0.3 of one value.
  EXPECT_NEAR(chart.points.front().upper, 50.0 + 3.0 * 0.3 * 2.0539, 1e-12);
  EXPECT_TRUE(chart.in_control());
}

TEST(ControlChartTest, MovingAverageSeesAShiftThatSingleValuesHide) {
  // A lasting shift of one and a half standard deviations; single values stay within three.
  const std::vector<double> values(20, 1.5);
  EXPECT_FALSE(ewma_chart(values, 0.0, 1.0, 0.2).in_control());
  for (const double value : values) EXPECT_LT(std::abs(value), 3.0);
}

TEST(ControlChartTest, MeansAreJudgedByTheScatterWithinGroups) {
  const std::vector<std::vector<double>> groups{{-1, 1}, {-1, 1}, {9, 11}};
  // s_r^2 = 2: limits 10/3 -+ 3 sqrt(2/2), and the means are 0, 0 and 10.
  const ControlChart chart = mean_chart(groups);
  EXPECT_NEAR(chart.centre, 10.0 / 3.0, 1e-14);
  EXPECT_NEAR(chart.standard_deviation, 1.0, 1e-14);
  EXPECT_NEAR(chart.points[2].value, 10.0, 1e-14);
  EXPECT_NEAR(chart.points[2].upper, 10.0 / 3.0 + 3.0, 1e-13);
  EXPECT_FALSE(chart.points[2].inside());
  EXPECT_FALSE(chart.in_control());
}

TEST(ControlChartTest, LimitsWithoutWidthJudgeNothing) {
  // The mean of three times this number is not the number.
  const std::vector<double> equal(3, 0.99825464);
  const ControlChart single = individuals_chart(equal);
  const ControlChart average = ewma_chart(equal, single.centre, single.standard_deviation, 0.2);
  const std::vector<std::vector<double>> groups{equal, {0.99825464, 0.99825464}};
  for (const ControlChart& chart : {single, average, mean_chart(groups)}) {
    EXPECT_FALSE(chart.has_spread());
    EXPECT_TRUE(chart.in_control());
    EXPECT_TRUE(chart.inside(0));
  }
  EXPECT_TRUE(individuals_chart(kFlowRates).has_spread());
  // A change of two units in the last digit is rounding, one of a thousand is not.
  const std::array<double, 3> changed{1.0, 1.0 + 1000 * 2.3e-16, 1.0};
  EXPECT_TRUE(individuals_chart(changed).has_spread());
}

TEST(ControlChartTest, RefusesWhatCannotBeCharted) {
  const std::array<double, 1> one{1.0};
  const std::array<double, 2> infinite{1.0, HUGE_VAL};
  EXPECT_THROW(individuals_chart(one), std::invalid_argument);
  EXPECT_THROW(individuals_chart(infinite), std::invalid_argument);
  EXPECT_THROW(ewma_chart(one, 0.0, 1.0, 0.0), std::invalid_argument);
  EXPECT_THROW(ewma_chart(one, 0.0, 1.0, 1.1), std::invalid_argument);
  EXPECT_THROW(ewma_chart(one, std::nan(""), 1.0, 0.2), std::invalid_argument);
  EXPECT_THROW(ewma_chart({}, 0.0, 1.0, 0.2), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
