#include "protocol/run/dwell_measurement.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/protocol/run/run_parts_fixture.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class DwellMeasurementTest : public test::RunPartsTest {
 protected:
  DwellMeasurementTest() {
    settings.protocol.settle_s = 0.2;
    settings.protocol.quiet_timeout_s = 0.5;
    settings.protocol.dwell_readings = 40;
    accelerometer.output = noisy;
    angle.experiment = 2;
    angle.alpha = angle.x = Angle::degrees(30);
  }

  /// @param usual_spread  spread of the dwells before; 0: none
  ItemDwell measure(double usual_spread = 0.0, std::optional<double> first_temperature_degc = {}) {
    Motion motion(context(), stage);
    std::map<int, double> first_temperatures;
    if (first_temperature_degc) first_temperatures[1] = *first_temperature_degc;
    const ItemChannels items(context(), instruments(), first_temperatures);
    if (usual_spread > 0.0)
      items.first().settling.spreads().add(Eigen::Vector3d::Constant(usual_spread), 0.0);
    std::vector<ItemDwell> measured = DwellMeasurement(context(), motion, items).measure(7, angle);
    EXPECT_EQ(measured.size(), 1U);
    return measured.at(0);
  }

  PlannedAngle angle;
};

TEST_F(DwellMeasurementTest, GivesTheDwellWithItsReadings) {
  const ItemDwell measured = measure();
  EXPECT_EQ(measured.dwell.experiment, 2);
  EXPECT_EQ(measured.dwell.commanded_x, Angle::degrees(30));
  EXPECT_EQ(measured.dwell.encoder_x, Angle::degrees(30));
  EXPECT_EQ(measured.dwell.count, 40);
  EXPECT_EQ(measured.dwell.flags, kFlagNone);
  EXPECT_NEAR(measured.dwell.mean[2], 1.0, 1e-4);
  EXPECT_GE(measured.dwell.settle_time_s, 0.2);
  ASSERT_EQ(measured.readings.size(), 40U);
  EXPECT_GT(*measured.dwell.time_s, measured.readings.front().time_s - 0.011);
  EXPECT_LT(*measured.dwell.time_s, measured.readings.back().time_s);
  EXPECT_EQ(observer.phases,
            (std::vector<std::pair<std::size_t, RunPhase>>{
                {7, RunPhase::kMoving}, {7, RunPhase::kSettling}, {7, RunPhase::kDwelling}}));
}

TEST_F(DwellMeasurementTest, ASingleShakeIsMeasuredAgain) {
  // The dwell is shaken once, after the check for quiet.
  accelerometer.output = [](std::uint64_t k) -> Eigen::Vector3d {
    return noisy(k) + (k > 30 && k < 45 ? 0.01 * static_cast<double>(k % 3) : 0.0) * Eigen::Vector3d::UnitX();
  };
  const ItemDwell measured = measure(0.6e-4);
  EXPECT_EQ(measured.dwell.flags, kFlagRepeated);
  ASSERT_EQ(observer.notices.size(), 1U);
  EXPECT_EQ(observer.notices[0].first, "repeated");
  EXPECT_THAT(observer.notices[0].second, HasSubstr("experiment 2, alpha = 30 deg: not quiet"));
}

TEST_F(DwellMeasurementTest, WhatDoesNotPassIsFlaggedAfterTheLastRepeat) {
  settings.limits.repeats = 2;
  const ItemDwell measured = measure(1e-6);  // Every spread is far above the usual one.
  EXPECT_EQ(measured.dwell.flags, kFlagNotQuiet | kFlagRepeated);
  EXPECT_EQ(observer.notices.size(), 2U);
}

TEST_F(DwellMeasurementTest, WaitsForTheTemperatureAndMeasuresAgain) {
  settings.limits.temperature_max_degc = 25.0;
  accelerometer.temperature_degc = 26.0;
  accelerometer.output = [this](std::uint64_t k) {
    if (k > 200) accelerometer.temperature_degc = 24.0;
    return noisy(k);
  };
  const ItemDwell measured = measure();
  EXPECT_EQ(measured.dwell.flags, kFlagHeld);
  EXPECT_EQ(observer.notices.size(), 2U);
  EXPECT_THAT(observer.notices[1].second, HasSubstr("the temperature came back"));
}

TEST_F(DwellMeasurementTest, ATemperatureThatStaysOutsideEndsTheRun) {
  settings.limits.temperature_max_degc = 25.0;
  settings.limits.temperature_wait_s = 20.0;
  accelerometer.temperature_degc = 26.0;
  const auto [fault, words] = failure_of([&] { measure(); });
  EXPECT_EQ(fault, Fault::kImplausible);
  EXPECT_THAT(words, HasSubstr("did not come back within 20 s"));
}

TEST_F(DwellMeasurementTest, AnAxisThatDoesNotStayEndsTheRun) {
  accelerometer.output = [this](std::uint64_t k) {
    stage.axes[0].encoder = Angle::degrees(30.5);  // It is pushed while readings come.
    return noisy(k);
  };
  const auto [fault, words] = failure_of([&] { measure(); });
  EXPECT_EQ(fault, Fault::kStalled);
  EXPECT_THAT(words, HasSubstr("it does not stay at experiment 2, alpha = 30 deg: X at 30.5"));
}

TEST_F(DwellMeasurementTest, ReadingsThatOnlyTheDriverMissedCountAsLost) {
  accelerometer.output = [this](std::uint64_t k) {
    if (k == 30) accelerometer.lost = 4;  // In the middle of the dwell.
    return noisy(k);
  };
  const ItemDwell measured = measure();
  EXPECT_EQ(measured.dwell.lost, 4);
  EXPECT_TRUE(measured.dwell.flags & kFlagLostReadings);
}

}  // namespace
}  // namespace abcal
