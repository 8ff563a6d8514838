#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <memory>

#include "drivers/instrument/instrument_error.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_bench.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

template <typename Action>
Fault fault_of(Action action) {
  try {
    action();
  } catch (const InstrumentError& error) {
    return error.fault();
  }
  ADD_FAILURE() << "nothing was thrown";
  return Fault::kBadFrame;
}

TEST(SimClockTest, SleepsByJumpingAndNeverBackwards) {
  SimClock clock;
  EXPECT_EQ(clock.utc_now(), Clock::UtcTime(std::chrono::sys_days{std::chrono::January / 1 / 2000}));
  const Clock::Instant start = clock.now();
  clock.sleep_until(start + std::chrono::hours(24));
  EXPECT_EQ(clock.now() - start, std::chrono::hours(24));
  EXPECT_EQ(clock.utc_now(), Clock::UtcTime(std::chrono::sys_days{std::chrono::January / 2 / 2000}));
  clock.sleep_until(start);
  EXPECT_EQ(clock.now() - start, std::chrono::hours(24));
}

class SimStageTest : public testing::Test {
 protected:
  void home_both() {
    for (const StageAxis axis : kStageAxes) {
      stage.home(axis);
      wait(axis);
    }
  }
  void wait(StageAxis axis) {
    for (int n = 0; n < 10000 && stage.motion_state(axis) == MotionState::kMoving; ++n)
      clock.sleep_until(clock.now() + milliseconds(20));
    ASSERT_EQ(stage.motion_state(axis), MotionState::kStopped);
  }

  SimClock clock;
  std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(BenchTruth{}, clock.now());
  SimStage stage{bench, clock};
};

TEST_F(SimStageTest, SaysWhatItIsAndWhetherItIsReferenced) {
  EXPECT_FALSE(stage.identify().axes[0].referenced);
  home_both();
  const StageInfo info = stage.identify();
  EXPECT_TRUE(info.axes[0].referenced);
  EXPECT_TRUE(info.axes[1].referenced);
  EXPECT_EQ(info.axes[0].travel_max.deg(), 360.0);
  EXPECT_EQ(info.axes[0].speed_deg_per_s, 20.0);
  EXPECT_EQ(info.axes[0].resolution.deg(), 1e-4);
}

TEST_F(SimStageTest, RefusesAMoveBeforeItIsHomed) {
  EXPECT_EQ(fault_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(5)); }), Fault::kNotReady);
  stage.home(StageAxis::kX);
  EXPECT_EQ(stage.motion_state(StageAxis::kX), MotionState::kMoving);
  EXPECT_EQ(fault_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(5)); }), Fault::kNotReady);
}

TEST_F(SimStageTest, RefusesATargetOutsideItsTravel) {
  home_both();
  EXPECT_EQ(fault_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(360.1)); }), Fault::kOutOfTravel);
  EXPECT_EQ(fault_of([&] {
              stage.move_to(StageAxis::kX, Angle::degrees(std::numeric_limits<double>::quiet_NaN()));
            }),
            Fault::kOutOfTravel);
}

TEST_F(SimStageTest, MovesAndSaysWhenItHasArrived) {
  home_both();
  stage.move_to(StageAxis::kZ, Angle::degrees(-90));
  EXPECT_EQ(stage.motion_state(StageAxis::kZ), MotionState::kMoving);
  EXPECT_EQ(stage.motion_state(StageAxis::kX), MotionState::kStopped);
  wait(StageAxis::kZ);
  EXPECT_EQ(stage.encoder_angle(StageAxis::kZ).deg(), -90.0);
}

TEST_F(SimStageTest, HaltsOnTheWayAndCutsASearchShort) {
  home_both();
  stage.move_to(StageAxis::kX, Angle::degrees(90));
  clock.sleep_until(clock.now() + seconds(1));
  EXPECT_TRUE(stage.halt());
  wait(StageAxis::kX);
  EXPECT_NEAR(stage.encoder_angle(StageAxis::kX).deg(), 20.0, 1e-4);
  stage.home(StageAxis::kX);
  EXPECT_TRUE(stage.halt());
  wait(StageAxis::kX);
  EXPECT_FALSE(stage.identify().axes[0].referenced);
}

TEST_F(SimStageTest, ScriptedFaultsAreFelt) {
  home_both();
  bench->inject({.kind = FaultKind::kRefusedMove, .at = clock.now(), .until = clock.now() + seconds(1)});
  EXPECT_EQ(fault_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(5)); }), Fault::kRefused);
  clock.sleep_until(clock.now() + seconds(1));
  bench->inject({.kind = FaultKind::kStalledAxis, .at = clock.now()});
  stage.move_to(StageAxis::kX, Angle::degrees(5));
  clock.sleep_until(clock.now() + std::chrono::hours(1));
  EXPECT_EQ(stage.motion_state(StageAxis::kX), MotionState::kMoving);
  bench->inject({.kind = FaultKind::kLostReference, .at = clock.now(), .axis = StageAxis::kZ});
  EXPECT_EQ(fault_of([&] { stage.move_to(StageAxis::kZ, Angle::degrees(5)); }), Fault::kNotReady);
}

class SimAccelerometerTest : public testing::Test {
 protected:
  SimClock clock;
  std::shared_ptr<SimBench> bench = [] {
    BenchTruth truth;
    truth.noise = 1e-4;
    truth.full_scale = 8.0;
    return std::make_shared<SimBench>(truth);
  }();
  SimAccelerometer accelerometer{bench, clock, 100.0};
};

TEST_F(SimAccelerometerTest, SaysWhatItIs) {
  const AccelerometerInfo info = accelerometer.identify();
  EXPECT_EQ(info.rate_hz, 100.0);
  EXPECT_EQ(info.output_unit, "g");
  EXPECT_EQ(info.full_scale, 8.0);
  EXPECT_EQ(info.resolution, std::nullopt);
}

TEST_F(SimAccelerometerTest, GivesNoReadingBeforeItIsStarted) {
  EXPECT_EQ(fault_of([&] { accelerometer.next(clock.now() + seconds(1)); }), Fault::kNotReady);
}

TEST_F(SimAccelerometerTest, MakesReadingsOnAFixedGrid) {
  clock.sleep_until(clock.now() + milliseconds(1234));
  accelerometer.start();
  for (std::uint64_t n = 124; n < 200; ++n) {
    const auto reading = accelerometer.next(clock.now() + seconds(1));
    ASSERT_TRUE(reading);
    EXPECT_EQ(reading->sequence, n);
    EXPECT_EQ(reading->arrival, Clock::Instant(milliseconds(10 * static_cast<int>(n))));
    EXPECT_EQ(clock.now(), reading->arrival);
    EXPECT_EQ(reading->output, bench->output(reading->arrival, n).value);
    EXPECT_EQ(reading->temperature_degc, 23.0);
    EXPECT_FALSE(reading->over_range);
  }
  EXPECT_EQ(accelerometer.health().readings, 76U);
}

TEST_F(SimAccelerometerTest, WaitsNoLongerThanItsDeadline) {
  accelerometer.start();
  const Clock::Instant deadline = clock.now() + milliseconds(7);
  EXPECT_EQ(accelerometer.next(deadline), std::nullopt);
  EXPECT_EQ(clock.now(), deadline);
}

TEST_F(SimAccelerometerTest, KeepsWhatCameWhileNobodyReadAndDiscardsItOnRequest) {
  accelerometer.start();
  clock.sleep_until(clock.now() + seconds(1));
  EXPECT_EQ(accelerometer.next(clock.now())->sequence, 1U);
  accelerometer.discard_pending();
  EXPECT_EQ(accelerometer.next(clock.now() + seconds(1))->sequence, 101U);
  EXPECT_EQ(accelerometer.health().lost_readings, 0U);
}

TEST_F(SimAccelerometerTest, CountsWhatItsQueueCouldNotHold) {
  accelerometer.start();
  clock.sleep_until(clock.now() + seconds(1000));  // 100000 readings
  const auto reading = accelerometer.next(clock.now());
  EXPECT_EQ(accelerometer.health().lost_readings, 100000U - 65536U);
  EXPECT_EQ(reading->sequence, 100000U - 65536U + 1U);
}

TEST_F(SimAccelerometerTest, WithoutOutputNothingComesByTheDeadline) {
  accelerometer.start();
  bench->inject({.kind = FaultKind::kNoOutput, .at = clock.now()});
  EXPECT_EQ(accelerometer.next(clock.now() + seconds(2)), std::nullopt);
  EXPECT_EQ(clock.now(), Clock::Instant(seconds(2)));
}

TEST_F(SimAccelerometerTest, RefusesARateThatIsNone) {
  EXPECT_THROW(SimAccelerometer(bench, clock, 0.0), std::invalid_argument);
}

}  // namespace
}  // namespace abcal::sim
