// When a sweep is refused and when it is measured again: each limit from both sides, on a stage and an
// accelerometer whose every sample the test chooses.
#include "protocol/run/sweep_measurement.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "tests/protocol/run/run_parts_fixture.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;

constexpr double kRate = 50.0;  // degrees/s
constexpr int kSteps = 36;
constexpr double kStep = 10.0;  // degrees: 0.2 s, 20 readings

/// A stage whose X axis turns without any acceleration.
class TurningStage final : public RotationStage {
 public:
  explicit TurningStage(Clock& clock) : clock_(clock) {}

  StageInfo identify() override { return {}; }
  void home(StageAxis) override {}
  void set_speed(StageAxis, std::optional<double> deg_per_s) override {
    from_ = to_ = x_at(clock_.now());
    speed_ = deg_per_s;
  }
  void move_to(StageAxis axis, Angle target) override {
    if (axis == StageAxis::kZ) return;
    from_ = x_at(clock_.now());
    to_ = target.deg();
    begin = clock_.now();
    if (!speed_) from_ = to_;
  }
  MotionState motion_state(StageAxis) override {
    return x_at(clock_.now()) == to_ ? MotionState::kStopped : MotionState::kMoving;
  }
  Angle encoder_angle(StageAxis axis) override {
    if (axis == StageAxis::kZ) return {};
    const double x = x_at(clock_.now());
    scatter = -scatter;
    return Angle::degrees(x == to_ ? x : x + scatter);
  }
  bool halt() noexcept override { return true; }

  double x_at(Clock::Instant at) const {
    const double way = speed_.value_or(0.0) * faster * to_seconds(at - begin);
    return way >= std::abs(to_ - from_) ? to_ : from_ + std::copysign(way, to_ - from_);
  }

  double faster = 1.0;   ///< Its speed over the commanded one.
  double scatter = 0.0;  ///< The samples of its encoder are off by this, up and down in turn (degree).
  Clock::Instant begin;  ///< The time of its latest move.

 private:
  Clock& clock_;
  std::optional<double> speed_;
  double from_ = 0.0, to_ = 0.0;
};

/// An accelerometer with a clock of its own. The test chooses which of its readings arrive.
class TimedAccelerometer final : public Accelerometer {
 public:
  explicit TimedAccelerometer(Clock& clock) : clock_(clock), begin_(clock.now() + 3ms) {}

  AccelerometerInfo identify() override {
    AccelerometerInfo info;
    info.model = "timed";
    info.output_unit = "g";
    info.rate_hz = 100.0;
    return info;
  }
  void start() override {}
  std::optional<Reading> next(Clock::Instant deadline) override {
    while (true) {
      const Clock::Instant at = begin_ + static_cast<std::int64_t>(count_) * period_;
      if (at > deadline) return std::nullopt;
      Reading reading;
      reading.sequence = first_ + count_++;
      reading.arrival = at;
      const auto part = [&](std::uint64_t factor) {
        return 1e-4 * static_cast<double>(reading.sequence * factor % 101);
      };
      reading.output = {part(37), 0.5 + part(53), 0.5 + part(71)};
      if (!is_lost || !is_lost(at)) return reading;
    }
  }
  void discard_pending() override {}
  StreamHealth health() const override { return {}; }
  void stop() noexcept override {}

  /// From now on its readings have another period; a gap in their numbers separates them from those before.
  void change_clock(Clock::Duration period) {
    first_ += count_ + 100;
    count_ = 0;
    begin_ = clock_.now() + 3ms;
    period_ = period;
  }

  std::function<bool(Clock::Instant at)> is_lost;

 private:
  Clock& clock_;
  Clock::Instant begin_;
  Clock::Duration period_ = 10ms;
  std::uint64_t first_ = 0, count_ = 0;
};

class SweepMeasurementTest : public test::RunPartsTest {
 protected:
  SweepMeasurementTest() {
    settings.protocol.motion = kMotionNames[1];
    settings.protocol.steps = kSteps;
    settings.protocol.step = Angle::degrees(kStep);
    settings.protocol.rate_deg_per_s = {kRate};
    settings.protocol.approach = Angle{};
    settings.limits.max_lost_fraction = 1.0;
    for (int sweep = 1; sweep <= 2; ++sweep) {
      for (int k = 0; k < kSteps; ++k) {
        PlannedAngle& angle = plan.emplace_back();
        const int step = sweep == 1 ? k : kSteps - 1 - k;
        angle.experiment = 1;
        angle.n = step + 1;
        angle.alpha = angle.x = Angle::degrees(kStep * step);
        angle.sweep = sweep;
        angle.rate_deg_per_s = sweep == 1 ? kRate : -kRate;
      }
    }
  }

  /// Measures the sweeps up and down, as far as `sweeps`.
  std::vector<PassedAngle> measure(int sweeps = 1) {
    if (!measurement_) {
      motion_.emplace(context(), turning);
      items_.emplace(context(), RunInstruments{turning, clock, {{1, timed, settings.limits, {}, {}}}},
                     std::map<int, double>{});
      measurement_.emplace(context(), *motion_, *items_);
    }
    std::vector<PassedAngle> passed;
    for (; measured_ < sweeps; ++measured_)
      passed = measurement_->measure(plan, static_cast<std::size_t>(measured_ * kSteps));
    return passed;
  }
  void expect_refused(Fault fault, const std::string& words) {
    const auto failure = failure_of([&] { measure(); });
    EXPECT_EQ(failure.first, fault);
    EXPECT_THAT(failure.second, HasSubstr(words));
  }
  /// Loses this number of readings in a row once the axis has passed an angle, in each of some sweeps.
  void lose_beyond(double angle_deg, int count, int sweeps) {
    timed.is_lost = [=, this, left = 0, sweeps_left = sweeps, was_below = false](Clock::Instant at) mutable {
      const bool is_below = turning.x_at(at) < angle_deg;
      if (was_below && !is_below && sweeps_left-- > 0) left = count;
      was_below = is_below;
      return left-- > 0;
    };
  }

  std::vector<PlannedAngle> plan;
  TurningStage turning{clock};
  TimedAccelerometer timed{clock};

 private:
  std::optional<Motion> motion_;
  std::optional<ItemChannels> items_;
  std::optional<SweepMeasurement> measurement_;
  int measured_ = 0;
};

TEST_F(SweepMeasurementTest, EachAngleHasTheReadingsOfItsStep) {
  const std::vector<PassedAngle> passed = measure();
  ASSERT_EQ(passed.size(), static_cast<std::size_t>(kSteps));
  for (std::size_t k = 0; k < passed.size(); ++k) {
    EXPECT_EQ(passed[k].position, k);
    ASSERT_EQ(passed[k].dwells.size(), 1U);
    const DwellRecord& dwell = passed[k].dwells[0].dwell;
    EXPECT_EQ(dwell.count, 20) << k;
    EXPECT_EQ(dwell.encoder_x, plan[k].x);
    EXPECT_EQ(dwell.encoder_z, Angle{});
    EXPECT_NEAR(dwell.motion->rate_deg_per_s, kRate, 1e-9);
    EXPECT_NEAR(dwell.motion->acceleration_deg_per_s2, 0.0, 1e-9);
    EXPECT_NEAR(dwell.motion->u_angle_deg, 0.0, 1e-9) << "neither the encoder nor the clock scatters";
    const double after_first_s = *dwell.time_s - *passed[0].dwells[0].dwell.time_s;
    EXPECT_NEAR(after_first_s, kStep / kRate * static_cast<double>(k), 1e-9);
  }
}

// 1 % is allowed either way.
TEST_F(SweepMeasurementTest, TheRateMayDifferByOnePerCent) {
  turning.faster = 1.00995;
  EXPECT_EQ(measure(1).size(), static_cast<std::size_t>(kSteps));
  turning.faster = 0.99005;
  EXPECT_EQ(measure(2).size(), static_cast<std::size_t>(kSteps));
}
TEST_F(SweepMeasurementTest, AFasterAxisIsRefused) {
  turning.faster = 1.01005;
  expect_refused(Fault::kStalled, "turned at 50.5 deg/s; required: within 1 %");
}
TEST_F(SweepMeasurementTest, ASlowerAxisIsRefused) {
  turning.faster = 0.98995;
  expect_refused(Fault::kStalled, "turned at 49.5 deg/s; required: within 1 %");
}

/// Samples that alternate about a line by `scatter` leave all of it to the fit, less its 14 coefficients:
/// those between half of the margins, 2.5 degrees and half a step beyond the first and the last angle.
double scatter_for(double rms_deg, double poll_interval_s) {
  const double count = (kStep * (kSteps - 1) + 2.0 * (0.5 * kStep + 0.05 * kRate)) / kRate / poll_interval_s;
  return rms_deg * std::sqrt((count - 14.0) / count);
}

// 20 ms at 50 degrees/s are 1 degree.
TEST_F(SweepMeasurementTest, TheSamplesMayScatterByTwentyMilliseconds) {
  turning.scatter = scatter_for(0.995, settings.protocol.poll_interval_s);
  EXPECT_EQ(measure().size(), static_cast<std::size_t>(kSteps));
}
TEST_F(SweepMeasurementTest, SamplesThatScatterByMoreAreRefused) {
  turning.scatter = scatter_for(1.005, settings.protocol.poll_interval_s);
  expect_refused(Fault::kImplausible, "required: below 1 deg");
}

// At 100 readings a second and 0.2 s a step, 20 numbers from one reading to the next are a step.
TEST_F(SweepMeasurementTest, ReadingsOfAStepMayBeMissing) {
  lose_beyond(100.0, 19, 3);
  EXPECT_EQ(measure().size(), static_cast<std::size_t>(kSteps));
  EXPECT_TRUE(observer.notices.empty());
}
TEST_F(SweepMeasurementTest, WithMoreMissingItIsMeasuredAgainAsOftenAsIsAllowed) {
  settings.limits.repeats = 2;
  lose_beyond(100.0, 20, 3);
  EXPECT_EQ(measure().size(), static_cast<std::size_t>(kSteps));
  EXPECT_EQ(observer.notices.size(), 2U);
  EXPECT_EQ(observer.phases.size(), 6U) << "moved and measured three times";
}
TEST_F(SweepMeasurementTest, AfterOneGapOneRepetitionIsEnough) {
  settings.limits.repeats = 2;
  lose_beyond(100.0, 20, 1);
  EXPECT_EQ(measure()[10].dwells.at(0).dwell.count, 20);
  EXPECT_EQ(observer.notices.size(), 1U);
}

/// Every `each`-th of the 20 readings of the step about 100 degrees arrives.
class ThinnedSweepTest : public SweepMeasurementTest {
 protected:
  void keep_each(int each) {
    timed.is_lost = [this, each, n = 0](Clock::Instant at) mutable {
      const double x = turning.x_at(at);
      return x >= 95.0 && x < 105.0 && ++n % each != 0;
    };
  }
};
TEST_F(ThinnedSweepTest, FourReadingsOfAStepAreEnough) {
  keep_each(5);
  EXPECT_EQ(measure()[10].dwells.at(0).dwell.count, 4);
}
TEST_F(ThinnedSweepTest, ThreeReadingsOfAStepAreTooFew) {
  keep_each(6);
  expect_refused(Fault::kImplausible,
                 "3 readings within one step about alpha = 100 deg at 50 deg/s; required: "
                 "at least 4");
}

// 200 parts in a million of 10 ms are 2000 ns.
class SweepClockTest : public SweepMeasurementTest {
 protected:
  /// The drift that is refused in the second sweep; empty: none.
  std::string refused_with(Clock::Duration period) {
    measure(1);
    timed.change_clock(period);
    try {
      measure(2);
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), Fault::kImplausible);
      return error.what();
    }
    return {};
  }
};
TEST_F(SweepClockTest, MayRunFasterBy200PartsInAMillion) {
  EXPECT_EQ(refused_with(10ms - 1990ns), "");
}
TEST_F(SweepClockTest, MayRunSlowerBy200PartsInAMillion) {
  EXPECT_EQ(refused_with(10ms + 1990ns), "");
}
TEST_F(SweepClockTest, OneThatRunsFasterIsRefused) {
  EXPECT_THAT(refused_with(10ms - 2010ns),
              AllOf(HasSubstr("every 9.997990 ms now"), HasSubstr("10.000000 ms"), HasSubstr("-201 parts"),
                    HasSubstr("within 200")));
}
TEST_F(SweepClockTest, OneThatRunsSlowerIsRefused) {
  EXPECT_THAT(refused_with(10ms + 2010ns), HasSubstr("+201 parts"));
}

TEST_F(SweepMeasurementTest, ASilentAccelerometerIsRefusedAfterItsTime) {
  settings.protocol.reading_timeout_s = 2.0;
  timed.is_lost = [](Clock::Instant) { return true; };
  expect_refused(Fault::kNoReply, "no reading for 2 s");
  // At two seconds it may still come; the next sample of the encoder is later.
  EXPECT_NEAR(to_seconds(clock.now() - turning.begin), 2.0 + settings.protocol.poll_interval_s, 1e-9);
}

}  // namespace
}  // namespace abcal
