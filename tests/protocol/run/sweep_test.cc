#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <optional>

#include "drivers/instrument/instrument_error.h"
#include "protocol/model/sweep_angle.h"
#include "protocol/run/experiment_run.h"
#include "protocol/run/sweep_bins.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_bench.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

constexpr double kRadian = std::numbers::pi / 180.0;

Clock::Instant at_s(double seconds) {
  return Clock::Instant(from_seconds(seconds));
}

/// Samples of an axis at 60 degrees/s with a ripple of its rate of 1e-3, once a turn; late by a pattern of
/// some milliseconds.
std::vector<AngleAtTime> rippled_samples(double late_s) {
  std::vector<AngleAtTime> samples;
  for (int k = 0; k < 300; ++k) {
    const double t = 0.02 * k;
    const double late = late_s * (0.5 + 0.5 * std::sin(7.3 * k));
    const double even = 60.0 * (t - late);
    samples.push_back({t, even + 1e-3 / kRadian * std::sin(even * kRadian)});
  }
  return samples;
}

TEST(SweepAngleTest, FindsRateAndRipple) {
  const auto turned = fit_sweep_angle(rippled_samples(0.0));
  ASSERT_TRUE(turned);
  EXPECT_NEAR(turned->mean_rate_deg_per_s(), 60.0, 1e-4);
  // A quarter of a turn from zero: the ripple is at its largest, its rate is even, and it brakes.
  EXPECT_NEAR(turned->angle_deg(1.5), 90.0 + 1e-3 / kRadian, 1e-4);
  EXPECT_NEAR(turned->rate_deg_per_s(1.5), 60.0, 1e-2);
  EXPECT_NEAR(turned->rate_deg_per_s(3.0), 60.0 * (1.0 - 1e-3), 1e-2);
  EXPECT_NEAR(turned->acceleration_deg_per_s2(1.5), -60.0 * 60.0 * kRadian * 1e-3, 1e-2);
}

TEST(SweepAngleTest, ItsUncertaintyFollowsTheScatterOfTheSamples) {
  const auto turned = fit_sweep_angle(rippled_samples(0.002));
  ASSERT_TRUE(turned);
  EXPECT_NEAR(turned->rms_deg(), 60.0 * 0.002 * 0.354, 0.005);
  EXPECT_NEAR(turned->u_deg(), turned->rms_deg() / std::sqrt(300.0), 1e-9);
  // Late by 1 ms on average.
  EXPECT_NEAR(turned->angle_deg(3.0), 180.0 - 0.06, 4.0 * turned->u_deg());
}

TEST(SweepAngleTest, NeedsSamples) {
  std::vector<AngleAtTime> samples = rippled_samples(0.0);
  samples.resize(24);
  EXPECT_TRUE(fit_sweep_angle(samples));
  samples.resize(23);
  EXPECT_FALSE(fit_sweep_angle(samples));
  EXPECT_FALSE(fit_sweep_angle(std::vector<AngleAtTime>(30, {1.0, 0.0})));
}

std::vector<PlannedAngle> circle(int steps, double rate_deg_per_s) {
  std::vector<PlannedAngle> angles;
  for (int n = 1; n <= steps; ++n) {
    PlannedAngle& angle = angles.emplace_back();
    angle.experiment = 1;
    angle.n = n;
    angle.alpha = angle.x = Angle::degrees(360.0 / steps * (n - 1));
    angle.sweep = 1;
    angle.rate_deg_per_s = rate_deg_per_s;
  }
  return angles;
}

/// Readings at 100 Hz of a sine with a second harmonic, seen at 60 degrees/s.
std::vector<Reading> sine_readings(double noise) {
  std::vector<Reading> readings;
  for (int k = -20; k < 640; ++k) {
    const double alpha = 0.6 * k * kRadian;
    Reading& reading = readings.emplace_back();
    reading.sequence = static_cast<std::uint64_t>(k + 20);
    reading.arrival = at_s(0.01 * k);
    const double wiggle = noise * std::sin(113.0 * k * k);
    reading.output = {std::cos(alpha) + 0.01 * std::cos(2.0 * alpha) + wiggle, std::sin(alpha) - wiggle, 0.3};
  }
  return readings;
}

SweepAngle even_turn() {
  SweepAngle::Coefficients even = SweepAngle::Coefficients::Zero();
  even(1) = 60.0;
  return {0.0, even, 1e-3, 300};
}

TEST(SweepBinsTest, AValueIsThatAtTheAngleItself) {
  const std::vector<PlannedAngle> angles = circle(36, 60.0);
  const auto bins = bins_of_sweep(angles, Angle::degrees(10.0), even_turn(), sine_readings(0.0));
  ASSERT_EQ(bins.size(), 36U);
  for (std::size_t k = 0; k < bins.size(); ++k) {
    const double alpha = angles[k].alpha.rad();
    EXPECT_NEAR(bins[k].value[0], std::cos(alpha) + 0.01 * std::cos(2.0 * alpha), 1e-9) << k;
    EXPECT_NEAR(bins[k].value[1], std::sin(alpha), 1e-9) << k;
    EXPECT_NEAR(to_seconds(bins[k].middle.time_since_epoch()), angles[k].alpha.deg() / 60.0, 1e-9) << k;
    EXPECT_GE(bins[k].readings.size(), 16U);
    EXPECT_LE(bins[k].readings.size(), 17U);
  }
}

TEST(SweepBinsTest, ItsNoiseIsThatOfTheReadings) {
  const auto bins = bins_of_sweep(circle(36, 60.0), Angle::degrees(10.0), even_turn(), sine_readings(1e-3));
  EXPECT_NEAR(bins[7].spread[0], 1e-3 * std::numbers::sqrt2 / 2.0, 1e-4);
  EXPECT_NEAR(bins[7].u[0], bins[7].spread[0] / 4.1, 1e-4);
}

TEST(SweepBinsTest, AStepWithoutReadingsHasNoValue) {
  std::vector<Reading> readings = sine_readings(0.0);
  std::erase_if(readings, [](const Reading& reading) {
    return reading.arrival > at_s(1.0) && reading.arrival < at_s(1.5);
  });
  const auto bins = bins_of_sweep(circle(36, 60.0), Angle::degrees(10.0), even_turn(), readings);
  EXPECT_TRUE(std::isnan(bins[7].value[0]));
  EXPECT_TRUE(bins[20].value.allFinite());
}

class KeepingObserver final : public RunObserver {
 public:
  void phase(std::size_t, RunPhase) override {}
  void dwells(std::size_t position, std::span<const ItemDwell>) override {
    positions.push_back(position);
    if (after_angle) after_angle();
  }
  void notice(std::string_view, const Message& text, std::optional<int>) override {
    notices.emplace_back(text);
  }
  std::vector<std::size_t> positions;
  std::vector<std::string> notices;
  std::function<void()> after_angle;
};

/// Runs at a constant rate on a simulated bench.
class SweepRunTest : public testing::Test {
 protected:
  SweepRunTest() {
    truth.noise = 1e-4;
    for (sim::AxisTruth* axis : {&truth.x, &truth.z}) {
      axis->speed_deg_per_s = 60.0;
      axis->acceleration_deg_per_s2 = 200.0;
    }
    protocol.motion = kMotionNames[1];
    protocol.acceleration_deg_per_s2 = 200.0;
    protocol.steps = 36;
    protocol.step = Angle::degrees(10.0);
    protocol.settle_auto = true;
    protocol.dwell_readings = 100;
    protocol.check_poses = false;
  }

  void build() {
    world = std::make_shared<sim::SimBench>(truth, clock.now());
    stage = std::make_unique<sim::SimStage>(world, clock);
    accelerometer = std::make_unique<sim::SimAccelerometer>(world, clock, 100.0);
    RunHeader header;
    header.plan = plan = make_rotation_plan(protocol, {});
    file.emplace(RunFile::create(path(), header));
  }

  void run(const RunProgress& so_far = {}) {
    RunSettings settings;
    settings.protocol = protocol;
    settings.limits = limits;
    run_experiments({*stage, clock, {{1, *accelerometer, limits, {}, {}}}}, {plan, settings, so_far}, *file,
                    observer, stop.get_token());
  }

  std::string failure(Fault expected) {
    try {
      run();
      ADD_FAILURE() << "the run did not notice";
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), expected) << error.what();
      EXPECT_FALSE(world->moving(StageAxis::kX, clock.now() + from_seconds(1.0)));
      EXPECT_EQ(RunFile::load(path()).state, RunState::kInterrupted);
      return error.what();
    }
    return {};
  }

  std::filesystem::path path() const { return folder / "a.run"; }

  test::TemporaryFolder folder;
  sim::BenchTruth truth;
  sim::SimClock clock;
  ProtocolConfig protocol;
  LimitsConfig limits;
  std::shared_ptr<sim::SimBench> world;
  std::unique_ptr<sim::SimStage> stage;
  std::unique_ptr<sim::SimAccelerometer> accelerometer;
  std::vector<PlannedAngle> plan;
  std::optional<RunFile> file;
  KeepingObserver observer;
  std::stop_source stop;
};

TEST_F(SweepRunTest, EveryAngleOfEverySweepIsStoredWithItsRate) {
  build();
  run();
  const StoredRun stored = RunFile::load(path());
  ASSERT_EQ(stored.record.dwells.size(), 216U);
  ASSERT_EQ(observer.positions.size(), 216U);
  for (std::size_t k = 0; k < 216; ++k) {
    const DwellRecord& dwell = stored.record.dwells[k];
    ASSERT_TRUE(dwell.motion);
    EXPECT_EQ(dwell.motion->sweep, plan[k].sweep);
    EXPECT_NEAR(dwell.motion->rate_deg_per_s, plan[k].rate_deg_per_s, 1e-2);
    EXPECT_EQ(dwell.n, plan[k].n);
    EXPECT_GE(dwell.count, plan[k].sweep == 1 ? 15 : 48);
    EXPECT_EQ(dwell.flags, kFlagNone);
    // The stage shows this at rest.
    const double alpha = dwell.alpha.rad();
    const Eigen::Vector3d at_rest =
        dwell.experiment == 1   ? Eigen::Vector3d(0.0, std::sin(alpha), std::cos(alpha))
        : dwell.experiment == 2 ? Eigen::Vector3d(-std::sin(alpha), 0.0, std::cos(alpha))
                                : Eigen::Vector3d(-std::sin(alpha), -std::cos(alpha), 0.0);
    EXPECT_LT((dwell.mean - at_rest).cwiseAbs().maxCoeff(), 2.5e-4) << k;
  }
  EXPECT_LT(to_seconds(clock.now() - Clock::Instant{}), 100.0);
  // A sweep down comes after one up, without a way between them.
  EXPECT_NEAR(*stored.record.dwells[36].time_s - *stored.record.dwells[35].time_s, 2.0, 1.0);
}

TEST_F(SweepRunTest, AnInterruptedRunGoesOnWithWholeSweeps) {
  build();
  observer.after_angle = [&] {
    if (observer.positions.size() == 40) stop.request_stop();
  };
  EXPECT_THROW(run(), RunInterrupted);
  StoredRun stored = RunFile::load(path());
  ASSERT_EQ(stored.record.dwells.size(), 72U) << "a sweep is on the disk as a whole, or not at all";
  observer.after_angle = nullptr;
  stop = {};
  RunProgress so_far;
  so_far.measured = {stored.measured.begin(), stored.measured.end()};
  so_far.last = {stored.measured.back(), {{1, stored.record.dwells.back()}}};
  run(so_far);
  stored = RunFile::load(path());
  EXPECT_EQ(stored.record.dwells.size(), 216U);
}

TEST_F(SweepRunTest, AMountThatSlippedBeforeTheContinuationIsNoticed) {
  build();
  observer.after_angle = [&] {
    if (observer.positions.size() == 40) stop.request_stop();
  };
  EXPECT_THROW(run(), RunInterrupted);
  const StoredRun stored = RunFile::load(path());
  observer.after_angle = nullptr;
  stop = {};
  sim::OutputTruth slipped = truth;
  slipped.offset = Eigen::Vector3d(0.01, 0.01, 0.01);
  world->change(slipped, clock.now());
  RunProgress so_far;
  so_far.measured = {stored.measured.begin(), stored.measured.end()};
  so_far.last = {stored.measured.back(), {{1, stored.record.dwells.back()}}};
  try {
    run(so_far);
    FAIL() << "the change was not noticed";
  } catch (const InstrumentError& error) {
    EXPECT_THAT(error.what(), HasSubstr("before the interruption"));
  }
}

TEST_F(SweepRunTest, AnAxisThatStallsEndsTheRun) {
  protocol.motion_timeout_s = 5.0;
  build();
  world->inject(
      {.kind = sim::FaultKind::kStalledAxis, .at = clock.now() + from_seconds(8.0), .axis = StageAxis::kX});
  EXPECT_THAT(failure(Fault::kStalled), HasSubstr("still moving"));
}

TEST_F(SweepRunTest, ASpeedThatTheStageDoesNotReachIsNoticed) {
  truth.x.acceleration_deg_per_s2 = 20.0;  // 180 degrees to 60 degrees/s.
  build();
  EXPECT_THAT(failure(Fault::kStalled), HasSubstr("acceleration_deg_per_s2"));
}

TEST_F(SweepRunTest, ASilentAccelerometerEndsTheSweep) {
  build();
  world->inject({.kind = sim::FaultKind::kNoOutput, .at = clock.now() + from_seconds(6.0)});
  EXPECT_THAT(failure(Fault::kNoReply), HasSubstr("during a sweep"));
}

TEST_F(SweepRunTest, ASweepWithAGapIsMeasuredAgain) {
  build();
  world->inject({.kind = sim::FaultKind::kNoOutput,
                 .at = clock.now() + from_seconds(6.0),
                 .until = clock.now() + from_seconds(6.6)});
  run();
  EXPECT_THAT(observer.notices, testing::Contains(HasSubstr("readings of more than a step are missing")));
  EXPECT_EQ(RunFile::load(path()).record.dwells.size(), 216U);
}

}  // namespace
}  // namespace abcal
