#pragma once

// Requirements on every stage and every accelerometer, real or simulated. For a test program with GoogleTest,
// also of a driver in a repository of its own: include this in one source, and give the cases.
//
//   INSTANTIATE_TEST_SUITE_P(MyStage, StageContract, testing::Values(StageCase{"my_stage", make_my_stage}),
//                            [](const auto& one) { return one.param.name; });
//
// in namespace abcal::contract. The instruments may be real (then the stage turns!) or simulated, in
// simulated or in real time.

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::contract {

using namespace std::chrono_literals;

/// A stage and its clock. Its travel ends between 150 and 360 deg.
struct StageBench {
  std::shared_ptr<Clock> clock;  ///< Destroyed after the stage.
  std::shared_ptr<RotationStage> stage;
  /// True angle of an axis, in the stage's own degrees; absent: the encoder's angle is taken.
  std::function<Angle(StageAxis)> true_angle{};
};

struct StageCase {
  std::string name;
  std::function<StageBench()> make;
  bool has_one_state = false;  ///< The controller reports one state for both axes.
};

/// An accelerometer at rest, and its clock.
struct AccelerometerBench {
  std::shared_ptr<Clock> clock;  ///< Destroyed after the accelerometer.
  std::shared_ptr<Accelerometer> accelerometer;
  Eigen::Vector3d expected{0.0, 0.0, 1.0};  ///< Output at rest, in the output unit.
  double noise = 1e-3;                      ///< Standard deviation of one output.
  double step = 5e-4;                       ///< Smallest step of an output.
};

struct AccelerometerCase {
  std::string name;
  std::function<AccelerometerBench()> make;
};

inline void PrintTo(const StageCase& stage, std::ostream* out) {
  *out << stage.name;
}
inline void PrintTo(const AccelerometerCase& accelerometer, std::ostream* out) {
  *out << accelerometer.name;
}

inline Fault fault_of(const std::function<void()>& call) {
  try {
    call();
  } catch (const InstrumentError& error) {
    EXPECT_STRNE(error.what(), "");
    return error.fault();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

class StageContract : public testing::TestWithParam<StageCase> {
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

  /// True angle of the axis; the encoder's angle if it is not known.
  Angle true_angle(StageAxis axis) {
    return bench.true_angle ? bench.true_angle(axis) : stage.encoder_angle(axis);
  }

  StageBench bench = GetParam().make();
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
      EXPECT_NEAR(true_angle(axis).deg(), target, 0.01);
    }
  }
}

TEST_P(StageContract, TheAxesMoveAtTheSameTimeAndIndependently) {
  reference_both();
  stage.move_to(StageAxis::kX, Angle::degrees(90.0));
  stage.move_to(StageAxis::kZ, Angle::degrees(10.0));
  ASSERT_TRUE(stops_within(StageAxis::kZ, 60s));
  EXPECT_TRUE(GetParam().has_one_state || stage.motion_state(StageAxis::kX) == MotionState::kMoving);
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
  const Angle where = true_angle(StageAxis::kX);
  wait(10s);
  EXPECT_NEAR(true_angle(StageAxis::kX).deg(), where.deg(), bench.true_angle ? 0.0 : 0.01);
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

class AccelerometerContract : public testing::TestWithParam<AccelerometerCase> {
 protected:
  AccelerometerBench bench = GetParam().make();
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
  // At rest: five standard errors of the mean, and a step of the output.
  const double tolerance = 5.0 * bench.noise / std::sqrt(50.0) + bench.step;
  EXPECT_NEAR(mean[0], bench.expected[0], tolerance);
  EXPECT_NEAR(mean[2], bench.expected[2], tolerance);
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

}  // namespace abcal::contract
