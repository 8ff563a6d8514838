// What every stage and every accelerometer must do, whatever it is made of: the same assertions on the
// simulated instruments without bytes and on each driver over its simulated firmware, in simulated time.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "app/bench/bench_config.h"
#include "app/bench/make_bench.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

std::string accelerometer_section(const std::string& driver) {
  if (driver.starts_with("scpi")) return "rate_hz = 20.0\nintegration_plc = 0.02\n";
  if (driver == "witmotion") return "rate_hz = 100.0\nbaud = 115200\n";
  return "rate_hz = 100.0\n";
}

Bench bench_of(const std::string& stage, const std::string& accelerometer) {
  return make_bench(parse_bench("[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"" + stage +
                                    "\"\nport = \"simulated\"\n[accelerometer]\ndriver = \"" + accelerometer +
                                    "\"\nport = \"simulated\"\n" + accelerometer_section(accelerometer) +
                                    "[simulation]\nnoise = 1e-3\n[simulation.x]\ntravel_min_deg = "
                                    "-200.0\ntravel_max_deg = 200.0\n",
                                "contract"));
}

Fault fault_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const InstrumentError& error) {
    EXPECT_STRNE(error.what(), "");
    return error.fault();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

class StageContract : public testing::TestWithParam<std::string> {
 protected:
  void wait(Clock::Duration duration) { clock.sleep_until(clock.now() + duration); }
  /// Polls as a run does; false if it is still moving after `longest`.
  bool stops_within(StageAxis axis, Clock::Duration longest) {
    const Clock::Instant last = clock.now() + longest;
    while (stage.motion_state(axis) == MotionState::kMoving) {
      if (clock.now() > last) return false;
      wait(50ms);
    }
    return true;
  }
  void reference_both() {
    for (const StageAxis axis : kStageAxes) {
      if (stage.identify().axes[index(axis)].referenced) continue;
      stage.home(axis);
      ASSERT_TRUE(stops_within(axis, 120s));
      ASSERT_TRUE(stage.identify().axes[index(axis)].referenced);
    }
  }

  Bench bench = bench_of(GetParam(), "simulated");
  RotationStage& stage = *bench.stage;
  Clock& clock = *bench.clock;
};

TEST_P(StageContract, SaysWhatItIs) {
  const StageInfo info = stage.identify();
  EXPECT_NE(info.model, "");
  for (const StageAxisInfo& axis : info.axes) EXPECT_LT(axis.travel_min, axis.travel_max);
  EXPECT_GE(info.axes[0].travel_min.deg(), -360.0);
}

TEST_P(StageContract, MovesEachAxisToWhereItIsToldAndSaysSo) {
  reference_both();
  for (const StageAxis axis : kStageAxes) {
    for (const double target : {30.0, -45.5, 0.0}) {
      const Clock::Instant begin = clock.now();
      stage.move_to(axis, Angle::degrees(target));
      EXPECT_EQ(stage.motion_state(axis), MotionState::kMoving);
      ASSERT_TRUE(stops_within(axis, 60s));
      EXPECT_GT(clock.now() - begin, 500ms);  // it takes the time that the motion takes
      EXPECT_NEAR(stage.encoder_angle(axis).deg(), target, 0.01);
      EXPECT_NEAR(bench.world->commanded_angle(axis, clock.now()).deg(), target, 0.01);
    }
  }
}

TEST_P(StageContract, TheAxesMoveAtTheSameTimeAndIndependently) {
  reference_both();
  stage.move_to(StageAxis::kX, Angle::degrees(90.0));
  stage.move_to(StageAxis::kZ, Angle::degrees(10.0));
  ASSERT_TRUE(stops_within(StageAxis::kZ, 60s));
  EXPECT_EQ(stage.motion_state(StageAxis::kX), MotionState::kMoving);
  ASSERT_TRUE(stops_within(StageAxis::kX, 60s));
  EXPECT_NEAR(stage.encoder_angle(StageAxis::kX).deg(), 90.0, 0.01);
  EXPECT_NEAR(stage.encoder_angle(StageAxis::kZ).deg(), 10.0, 0.01);
}

TEST_P(StageContract, RefusesATargetOutsideTheTravelAndStaysWhereItIs) {
  reference_both();
  const Angle beyond = stage.identify().axes[0].travel_max + Angle::degrees(1.0);
  EXPECT_EQ(fault_of([&] { stage.move_to(StageAxis::kX, beyond); }), Fault::kOutOfTravel);
  EXPECT_EQ(stage.motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_NEAR(stage.encoder_angle(StageAxis::kX).deg(), 0.0, 0.01);
}

TEST_P(StageContract, AHaltStopsBothAxesOnTheirWay) {
  reference_both();
  stage.move_to(StageAxis::kX, Angle::degrees(150.0));
  stage.move_to(StageAxis::kZ, Angle::degrees(150.0));
  wait(1s);
  EXPECT_TRUE(stage.halt());
  for (const StageAxis axis : kStageAxes) {
    ASSERT_TRUE(stops_within(axis, 3s));
    EXPECT_LT(stage.encoder_angle(axis).deg(), 100.0);
  }
  const Angle where = bench.world->commanded_angle(StageAxis::kX, clock.now());
  wait(10s);
  EXPECT_EQ(bench.world->commanded_angle(StageAxis::kX, clock.now()).deg(), where.deg());
}

TEST_P(StageContract, MovesAgainAfterAHalt) {
  reference_both();
  EXPECT_TRUE(stage.halt());
  stage.identify();
  reference_both();
  stage.move_to(StageAxis::kZ, Angle::degrees(5.0));
  ASSERT_TRUE(stops_within(StageAxis::kZ, 60s));
  EXPECT_NEAR(stage.encoder_angle(StageAxis::kZ).deg(), 5.0, 0.01);
}

INSTANTIATE_TEST_SUITE_P(Of, StageContract,
                         testing::Values("simulated", "pi_gcs", "newport_esp", "zaber_ascii"),
                         [](const auto& parameter) { return parameter.param; });

class AccelerometerContract : public testing::TestWithParam<std::string> {
 protected:
  Bench bench = bench_of("simulated", GetParam());
  Accelerometer& accelerometer = *bench.accelerometer;
  Clock& clock = *bench.clock;
};

TEST_P(AccelerometerContract, SaysWhatItIs) {
  const AccelerometerInfo info = accelerometer.identify();
  EXPECT_NE(info.model, "");
  EXPECT_NE(info.output_unit, "");
}

TEST_P(AccelerometerContract, GivesNothingBeforeItIsStarted) {
  accelerometer.identify();
  EXPECT_EQ(fault_of([&] { accelerometer.next(clock.now() + 1s); }), Fault::kNotReady);
}

TEST_P(AccelerometerContract, GivesReadingsInOrderWithoutGapsAtItsRate) {
  const AccelerometerInfo info = accelerometer.identify();
  accelerometer.start();
  accelerometer.discard_pending();
  std::vector<Reading> readings;
  while (readings.size() < 50) {
    const auto reading = accelerometer.next(clock.now() + 2s);
    ASSERT_TRUE(reading);
    readings.push_back(*reading);
  }
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < readings.size(); ++i) {
    mean += readings[i].output / 50.0;
    if (i == 0) continue;
    EXPECT_EQ(readings[i].sequence, readings[i - 1].sequence + 1);
    EXPECT_GE(readings[i].arrival, readings[i - 1].arrival);
  }
  // At rest, R per g_loc = 1, noise 1e-3: five standard errors, and a step of 16 g / 32768.
  EXPECT_NEAR(mean[0], 0.0, 5e-3 / std::sqrt(50.0) + 5e-4);
  EXPECT_NEAR(mean[2], 1.0, 5e-3 / std::sqrt(50.0) + 5e-4);
  EXPECT_EQ(accelerometer.health().lost_readings, 0U);
  EXPECT_EQ(accelerometer.health().bad_frames, 0U);
  if (info.rate_hz > 0.0) {
    const double rate = 49.0 / to_seconds(readings.back().arrival - readings.front().arrival);
    EXPECT_NEAR(rate / info.rate_hz, 1.0, 0.05);
  }
}

TEST_P(AccelerometerContract, ADeadlineThatHasPassedGivesNothingAndIsNoError) {
  accelerometer.identify();
  accelerometer.start();
  accelerometer.discard_pending();
  EXPECT_FALSE(accelerometer.next(clock.now()));
  EXPECT_TRUE(accelerometer.next(clock.now() + 2s));
}

TEST_P(AccelerometerContract, WhatWasDiscardedIsOldAndNotLost) {
  accelerometer.identify();
  accelerometer.start();
  clock.sleep_until(clock.now() + 3s);
  const Clock::Instant before = clock.now();
  accelerometer.discard_pending();
  const auto reading = accelerometer.next(clock.now() + 2s);
  ASSERT_TRUE(reading);
  EXPECT_GE(reading->arrival, before);
  EXPECT_EQ(accelerometer.health().lost_readings, 0U);
}

TEST_P(AccelerometerContract, IsStartedAgainAfterAStop) {
  accelerometer.identify();
  accelerometer.start();
  accelerometer.stop();
  accelerometer.start();
  EXPECT_TRUE(accelerometer.next(clock.now() + 2s));
}

INSTANTIATE_TEST_SUITE_P(Of, AccelerometerContract,
                         testing::Values("simulated", "microstrain_mip", "vectornav", "xsens_mti",
                                         "scpi_voltmeter", "scpi_single", "witmotion", "text_line"),
                         [](const auto& parameter) { return parameter.param; });

}  // namespace
}  // namespace abcal
