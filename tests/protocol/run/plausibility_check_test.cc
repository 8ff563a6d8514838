#include "protocol/run/plausibility_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/protocol/run/run_parts_fixture.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class PlausibilityCheckTest : public test::RunPartsTest {
 protected:
  PlausibilityCheckTest() {
    statistics.count = 100;
    statistics.mean = Eigen::Vector3d(0.0, 0.0, 1.0);
    statistics.spread = Eigen::Vector3d::Constant(1e-4);
    statistics.u_mean = Eigen::Vector3d::Constant(1e-5);
  }
  PlausibilityCheck check(std::optional<double> first_temperature_degc = {}) {
    return PlausibilityCheck(context(), first_temperature_degc);
  }
  DwellStatistics statistics;
  PlannedAngle angle;
};

TEST_F(PlausibilityCheckTest, SoundReadingsPass) {
  check().require_possible(angle, statistics, 100);
  EXPECT_EQ(check().flags(statistics, Eigen::Vector3d::Constant(1e-4)), kFlagNone);
}

TEST_F(PlausibilityCheckTest, TooManyLostOrNotFiniteEndTheRun) {
  statistics.lost = 101;
  EXPECT_THAT(failure_of([&] { check().require_possible(angle, statistics, 100); }).second,
              HasSubstr("max_lost_fraction"));
  statistics.lost = 100;
  check().require_possible(angle, statistics, 100);
  statistics.not_finite = 51;
  EXPECT_THAT(failure_of([&] { check().require_possible(angle, statistics, 100); }).second,
              HasSubstr("not finite"));
}

TEST_F(PlausibilityCheckTest, TheSameThreeNumbersAtTwoAnglesEndTheRun) {
  statistics.spread.setZero();
  PlausibilityCheck with_memory = check();
  with_memory.require_possible(angle, statistics, 100);
  DwellRecord before;
  before.mean = statistics.mean;
  with_memory.remember(before);
  const auto [fault, words] = failure_of([&] { with_memory.require_possible(angle, statistics, 100); });
  EXPECT_EQ(fault, Fault::kImplausible);
  EXPECT_THAT(words, HasSubstr("the output is stuck"));
  statistics.mean[0] += 1e-9;
  with_memory.require_possible(angle, statistics, 100);
}

TEST_F(PlausibilityCheckTest, FlagsShakenStuckWarmAndWrongNorm) {
  const Eigen::Vector3d usual = Eigen::Vector3d::Constant(1e-4);
  settings.limits.temperature_max_degc = 25.0;
  DwellStatistics shaken = statistics;
  shaken.spread[1] = 1e-2;
  EXPECT_EQ(check().flags(shaken, usual), kFlagNotQuiet);
  DwellStatistics stuck = statistics;
  stuck.spread[2] = 0.0;
  EXPECT_EQ(check().flags(stuck, usual), kFlagStuck);
  DwellStatistics warm = statistics;
  warm.temperature_degc = 25.1;
  EXPECT_EQ(check().flags(warm, usual), kFlagTemperature);
  DwellStatistics heavy = statistics;
  heavy.mean *= 1.5;
  EXPECT_EQ(check().flags(heavy, usual), kFlagNorm);
}

TEST_F(PlausibilityCheckTest, TheFirstTemperatureIsThatOfTheFirstAngle) {
  settings.limits.temperature_change_degc = 0.5;
  PlausibilityCheck with_memory = check();
  EXPECT_FALSE(with_memory.temperature_excess(23.0));
  DwellRecord first;
  first.temperature_degc = 23.0;
  with_memory.remember(first);
  EXPECT_FALSE(with_memory.temperature_excess(23.4));
  EXPECT_TRUE(with_memory.temperature_excess(23.6));
  EXPECT_TRUE(check(21.0).temperature_excess(23.0)) << "of the run that was interrupted";
}

TEST_F(PlausibilityCheckTest, TheCircleOfAnExperimentShowsAWrongFullScale) {
  PlausibilityCheck with_memory = check();
  std::optional<std::string> excess;
  for (int n = 0; n < 12; ++n) {
    DwellRecord dwell;
    dwell.experiment = 1;
    dwell.n = n + 1;
    dwell.alpha = Angle::degrees(30.0 * n);
    const SinCos turned = sincos(dwell.alpha);
    dwell.mean = 1.02 * Eigen::Vector3d(turned.sin, turned.cos, 0.0);
    excess = with_memory.full_scale_excess(dwell, n == 11);
    EXPECT_EQ(excess.has_value(), n == 11);
  }
  EXPECT_THAT(excess.value_or(""), HasSubstr("sensitivity_tolerance"));
}

}  // namespace
}  // namespace abcal
