#include "protocol/run/reading_plausibility.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "protocol/model/forward_model.h"

namespace abcal {
namespace {

using testing::HasSubstr;

DwellStatistics spread_of(const Eigen::Vector3d& spread, std::int64_t count) {
  DwellStatistics statistics;
  statistics.count = count;
  statistics.spread = spread;
  return statistics;
}

TEST(IsStuck, AnOutputWithoutAnyChangeIsStuckWhereItsNoiseIsKnown) {
  const Eigen::Vector3d usual = Eigen::Vector3d::Constant(1e-4);
  EXPECT_TRUE(is_stuck(spread_of({1e-4, 0.0, 1e-4}, 20), usual, 0.0));
  EXPECT_TRUE(is_stuck(spread_of({1e-4, 0.0, 1e-4}, 20), usual, 1e-5));
  EXPECT_FALSE(is_stuck(spread_of({1e-4, 1e-6, 1e-4}, 20), usual, 1e-5));
  EXPECT_FALSE(is_stuck(spread_of({1e-4, 0.0, 1e-4}, 20), std::nullopt, 1e-5));
  EXPECT_FALSE(is_stuck(spread_of({1e-4, 0.0, 1e-4}, 7), usual, 1e-5));
}

TEST(IsStuck, AnOutputThatIsFrozenFromTheStartIsJudgedByTheNoiseOfTheOthers) {
  const double unknown = std::nan("");
  EXPECT_TRUE(is_stuck(spread_of({0.0, 1e-4, 1e-4}, 20), Eigen::Vector3d(unknown, 1e-4, 2e-4), 1e-6));
  // Noise below the resolution: the others show steps, and this one may well stand still.
  EXPECT_FALSE(is_stuck(spread_of({0.0, 5e-4, 5e-4}, 20), Eigen::Vector3d(unknown, 5e-4, 5e-4), 1e-3));
  LimitsConfig limits;
  EXPECT_FALSE(
      is_shaken(spread_of({1e-4, 1e-4, 1e-4}, 20), Eigen::Vector3d(unknown, 1e-4, 1e-4), 0.0, limits));
}

TEST(IsStuck, NoiseBelowTheResolutionMayLeaveAllReadingsAlike) {
  // Noise of a quarter of a step: in the middle of a step 95 % of the readings are alike.
  const double step = 1e-3, noise = 0.25 * step;
  const double usual = std::sqrt(noise * noise + step * step / 12.0);
  EXPECT_FALSE(is_stuck(spread_of(Eigen::Vector3d::Zero(), 50), Eigen::Vector3d::Constant(usual), step));
  EXPECT_TRUE(is_stuck(spread_of(Eigen::Vector3d::Zero(), 1000), Eigen::Vector3d::Constant(usual), step));
}

TEST(IsShaken, NeedsMoreThanTheFactorAndMoreThanNoiseDoes) {
  LimitsConfig limits;
  const Eigen::Vector3d usual = Eigen::Vector3d::Constant(1e-4);
  EXPECT_FALSE(is_shaken(spread_of({2.9e-4, 1e-4, 1e-4}, 1000), usual, 0.0, limits));
  EXPECT_TRUE(is_shaken(spread_of({1e-4, 3.1e-4, 1e-4}, 1000), usual, 0.0, limits));
  limits.spread_factor = 1.01;
  // At 1000 readings noise reaches 1.12 times the usual spread once in 1e6 dwells, at 20 readings 2.
  EXPECT_FALSE(is_shaken(spread_of({1.08e-4, 1e-4, 1e-4}, 1000), usual, 0.0, limits));
  EXPECT_TRUE(is_shaken(spread_of({1.15e-4, 1e-4, 1e-4}, 1000), usual, 0.0, limits));
  EXPECT_FALSE(is_shaken(spread_of({1.5e-4, 1e-4, 1e-4}, 20), usual, 0.0, limits));
  EXPECT_FALSE(is_shaken(spread_of({1e-4, 1e-4, 5e-4}, 1000), usual, 1e-3, limits));  // one step
}

TEST(TemperatureExcess, NamesTheLimitThatIsPassed) {
  LimitsConfig limits;
  EXPECT_FALSE(temperature_excess(std::nullopt, 23.0, limits, {}));
  EXPECT_FALSE(temperature_excess(27.8, 23.0, limits, {}));
  EXPECT_THAT(*temperature_excess(28.0, 23.0, limits, {}), HasSubstr("+5.00 from the first angle"));
  EXPECT_FALSE(temperature_excess(28.0, std::nullopt, limits, {}));
  limits.temperature_max_degc = 26.0;
  EXPECT_THAT(*temperature_excess(26.1, 26.0, limits, {}), HasSubstr("temperature_max_degc"));
  EXPECT_TRUE(temperature_excess(std::nan(""), 23.0, limits, {}));
}

std::vector<DwellRecord> circle(int experiment, int steps, const AccelerometerModel& accelerometer) {
  std::vector<DwellRecord> dwells;
  for (int n = 1; n <= steps; ++n) {
    DwellRecord dwell;
    dwell.experiment = experiment;
    dwell.n = n;
    dwell.alpha = Angle::degrees(360.0 / steps) * (n - 1);
    dwell.mean = response(accelerometer, gravity_in_aut(experiment, n, dwell.alpha, {}));
    dwell.u_mean = Eigen::Vector3d::Constant(1e-6);
    dwells.push_back(dwell);
  }
  return dwells;
}

TEST(FullScale, IsSeenInACircleWhateverOffsetAndMounting) {
  AccelerometerModel accelerometer;
  accelerometer.offset = {0.1, -0.2, 0.3};
  accelerometer.sensitivity_matrix =
      Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  for (int experiment = 1; experiment <= 3; ++experiment) {
    const auto dwells = circle(experiment, 12, accelerometer);
    EXPECT_NEAR(response_of_circle(dwells)->at_zero, 1.0, 1e-12);
    EXPECT_NEAR(response_of_circle(dwells)->at_one_g, 1.0, 1e-12);
    EXPECT_FALSE(full_scale_excess(dwells, 1.0, {}));
    EXPECT_THAT(*full_scale_excess(dwells, 1.01, {}), HasSubstr("-0.99 % from the nominal"));
    EXPECT_THAT(*full_scale_excess(dwells, 0.99, {}), HasSubstr("+1.01 %"));
  }
}

TEST(FullScale, AxesThatAreNotOrthogonalDoNotLookLikeAWrongOne) {
  AccelerometerModel accelerometer;
  accelerometer.sensitivity_matrix << 1.0, 0.02, 0.0, 0.0, 1.0, 0.02, 0.02, 0.0, 1.0;  // 1.1 degrees
  EXPECT_FALSE(full_scale_excess(circle(1, 8, accelerometer), 1.0, {}));
}

// k2 and k3 drawn at the default size of 1e-2: a sound item, whose response at 1 g differs by some per cent.
TEST(FullScale, ASoundItemThatIsNotLinearIsNoWrongOne) {
  std::mt19937_64 engine(7);
  std::normal_distribution<double> normal(0.0, 1e-2);
  for (int item = 0; item < 200; ++item) {
    AccelerometerModel accelerometer;
    for (Eigen::Index j = 0; j < 3; ++j) {
      accelerometer.k2(j) = normal(engine);
      accelerometer.k3(j) = normal(engine);
    }
    for (int experiment = 1; experiment <= 3; ++experiment) {
      const auto dwells = circle(experiment, 12, accelerometer);
      EXPECT_EQ(full_scale_excess(dwells, 1.0, {}).value_or(Message()), "");
      EXPECT_NEAR(response_of_circle(dwells)->at_zero, 1.0, 1e-3);
      // Twice the nominal is found all the same.
      EXPECT_TRUE(full_scale_excess(dwells, 0.5, {}));
    }
  }
}

TEST(FullScale, IsNotJudgedFromPartOfACircle) {
  auto dwells = circle(1, 12, {});
  dwells.resize(9);
  EXPECT_FALSE(response_of_circle(dwells));
  EXPECT_FALSE(response_of_circle(circle(1, 6, {})));  // three pairs
  EXPECT_FALSE(response_of_circle(circle(1, 7, {})));  // no angles 180 degrees apart
}

TEST(NormOfOneAngle, CatchesAnotherUnit) {
  const LimitsConfig limits;
  EXPECT_FALSE(norm_is_wrong({0.1, 0.1, 1.05}, 1.0, limits));
  EXPECT_TRUE(norm_is_wrong({0.0, 0.0, 9.81}, 1.0, limits));
  EXPECT_TRUE(norm_is_wrong({0.0, 0.0, 0.5}, 1.0, limits));
  EXPECT_TRUE(norm_is_wrong({0.0, 0.0, std::nan("")}, 1.0, limits));
}

TEST(IsStable, WhenNothingMovesForSoLong) {
  std::vector<StabilityWindow> windows;
  const auto add = [&](double mean, double temperature) {
    windows.push_back({10.0 * static_cast<double>(windows.size() + 1), Eigen::Vector3d(0, 0, mean),
                       Eigen::Vector3d::Constant(1e-6), temperature});
  };
  EXPECT_FALSE(is_stable(windows, 30.0, {}, {}));
  add(1.0010, 20.0);  // still warming up
  add(1.0005, 21.5);
  add(1.00003, 22.0);
  add(1.00002, 22.2);
  EXPECT_FALSE(is_stable(windows, 30.0, {}, {}));
  add(1.00001, 22.4);
  EXPECT_FALSE(is_stable(windows, 30.0, {}, {}));  // the second window is 30 s back
  add(1.00000, 22.5);
  EXPECT_TRUE(is_stable(windows, 30.0, {}, {}));
  LimitsConfig tighter;
  tighter.stability_degc = 0.2;
  EXPECT_FALSE(is_stable(windows, 30.0, tighter, {}));
  tighter = {};
  tighter.stability = 1e-5;
  EXPECT_FALSE(is_stable(windows, 30.0, tighter, {}));
}

}  // namespace
}  // namespace abcal
