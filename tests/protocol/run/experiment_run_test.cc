#include "protocol/run/experiment_run.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>

#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/limits.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_bench.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class SilentObserver : public RunObserver {
 public:
  void phase(std::size_t, RunPhase phase) override {
    if (on_phase) on_phase(phase);
  }
  void dwells(std::size_t, std::span<const ItemDwell> dwells) override {
    measured.push_back(dwells.front().dwell);
    if (after_dwell) after_dwell();
  }
  void notice(std::string_view, const Message& text, std::optional<int>) override {
    notices.emplace_back(text);
  }
  std::vector<DwellRecord> measured;
  std::vector<std::string> notices;
  std::function<void()> after_dwell;
  std::function<void(RunPhase)> on_phase;
};

/// Records the moves and counts the halts of the stage.
class WatchedStage final : public RotationStage {
 public:
  explicit WatchedStage(std::unique_ptr<RotationStage> inner) : inner_(std::move(inner)) {}
  StageInfo identify() override { return inner_->identify(); }
  void home(StageAxis axis) override { inner_->home(axis); }
  void move_to(StageAxis axis, Angle target) override {
    moves.emplace_back(axis, target);
    inner_->move_to(axis, target);
  }
  MotionState motion_state(StageAxis axis) override { return inner_->motion_state(axis); }
  Angle encoder_angle(StageAxis axis) override { return inner_->encoder_angle(axis); }
  bool halt() noexcept override {
    ++halts;
    return inner_->halt() && acknowledges_halt;
  }
  std::vector<std::pair<StageAxis, Angle>> moves;
  int halts = 0;
  bool acknowledges_halt = true;

 private:
  std::unique_ptr<RotationStage> inner_;
};

class ExperimentRunTest : public testing::Test {
 protected:
  ExperimentRunTest() {
    truth.noise = 1e-4;
    truth.offset = Eigen::Vector3d(0.01, 0.02, 0.03);
    protocol.steps = 12;
    protocol.step = Angle::degrees(30);
    protocol.settle_s = 0.5;
    protocol.dwell_readings = 40;
    protocol.motion_timeout_s = 10.0;
    protocol.check_poses = false;
  }

  void build() {
    world = std::make_shared<sim::SimBench>(truth, clock.now());
    stage = std::make_unique<WatchedStage>(std::make_unique<sim::SimStage>(world, clock));
    accelerometer = std::make_unique<sim::SimAccelerometer>(world, clock, 100.0);
    plan = make_rotation_plan(protocol, {});
    RunHeader header;
    header.plan = plan;
    file.emplace(RunFile::create(folder / "a.run", header));
  }

  RunSettings settings() const {
    RunSettings all;
    all.protocol = protocol;
    all.limits = limits;
    return all;
  }

  RunInstruments instruments(Clock& of_the_run) const {
    const RunSettings all = settings();
    return {*stage, of_the_run, {{1, *accelerometer, all.limits, all.tolerances, all.expected}}};
  }

  RunTiming run(const std::set<std::size_t>& measured = {}) {
    RunProgress so_far;
    so_far.measured = measured;
    return run_experiments(instruments(clock), {plan, settings(), so_far}, *file, observer, stop.get_token());
  }

  /// Runs into the fault and gives its words; the run must be left interrupted, the stage halted.
  std::string failure(Fault expected) {
    try {
      run();
      ADD_FAILURE() << "the run did not notice";
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), expected) << error.what();
      EXPECT_EQ(stage->halts, 1);
      const StoredRun stored = RunFile::load(folder / "a.run");
      EXPECT_EQ(stored.state, RunState::kInterrupted);
      EXPECT_THAT(stored.events.back().text, HasSubstr(error.detail().english().substr(0, 20)));
      EXPECT_EQ(stored.record.dwells.size(), observer.measured.size());
      return error.what();
    }
    return {};
  }

  void inject_after(std::size_t dwells, sim::WorldFault fault) {
    observer.after_dwell = [this, dwells, fault]() mutable {
      if (observer.measured.size() != dwells) return;
      fault.at = clock.now();
      world->inject(fault);
    };
  }

  test::TemporaryFolder folder;
  sim::SimClock clock;
  sim::BenchTruth truth;
  ProtocolConfig protocol;
  LimitsConfig limits;
  std::shared_ptr<sim::SimBench> world;
  std::unique_ptr<WatchedStage> stage;
  std::unique_ptr<Accelerometer> accelerometer;
  std::vector<PlannedAngle> plan;
  std::optional<RunFile> file;
  SilentObserver observer;
  std::stop_source stop;
};

TEST_F(ExperimentRunTest, StoresEveryAngleWithItsReadingsAndParksTheStage) {
  build();
  const RunTiming timing = run();
  EXPECT_EQ(observer.measured.size(), plan.size());
  EXPECT_THAT(observer.notices, testing::IsEmpty());
  const StoredRun stored = RunFile::load(folder / "a.run");
  ASSERT_EQ(stored.record.dwells.size(), plan.size());
  for (const DwellRecord& dwell : stored.record.dwells) {
    EXPECT_EQ(dwell.count, 40);
    EXPECT_EQ(dwell.flags, kFlagNone);
    EXPECT_GE(dwell.settle_time_s, protocol.settle_s);
    EXPECT_NEAR(dwell.encoder_x->deg(), dwell.commanded_x.deg(), protocol.position_window.deg());
  }
  SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select count(*) from reading"), std::to_string(40 * plan.size()));
  EXPECT_NEAR(stage->encoder_angle(StageAxis::kX).deg(), 0.0, 0.01);
  EXPECT_NEAR(stage->encoder_angle(StageAxis::kZ).deg(), 0.0, 0.01);
  EXPECT_GT(timing.moving_s, 0.0);
  EXPECT_NEAR(timing.total_s(), to_seconds(clock.now() - Clock::Instant{}), 1e-6);
}

TEST_F(ExperimentRunTest, ComesToEveryAngleFromBelow) {
  truth.x.backlash = truth.z.backlash = Angle::degrees(0.5);
  build();
  run();
  std::array<Angle, 2> at{};
  int final_moves_down = 0;
  for (std::size_t k = 0; k < stage->moves.size(); ++k) {
    const auto& [axis, target] = stage->moves[k];
    const bool down = target < at[index(axis)];
    at[index(axis)] = target;
    // A move down is only ever the overshoot before the move up to the angle itself.
    if (down && !(k + 1 < stage->moves.size() && stage->moves[k + 1].first == axis &&
                  stage->moves[k + 1].second > target)) {
      ++final_moves_down;
    }
  }
  EXPECT_EQ(final_moves_down, 0);
}

/// A simulated clock that acts once, at a time.
class ActingClock final : public Clock {
 public:
  explicit ActingClock(sim::SimClock& inner) : inner_(inner) {}
  Instant now() const override { return inner_.now(); }
  UtcTime utc_now() const override { return inner_.utc_now(); }
  void sleep_until(Instant instant) override {
    inner_.sleep_until(instant);
    if (act && inner_.now() >= at) std::exchange(act, nullptr)();
  }
  Instant at;
  std::function<void()> act;

 private:
  sim::SimClock& inner_;
};

// Seen: a run whose file was renamed, or whose folder was removed, was measured to its end and lost.
TEST_F(ExperimentRunTest, HoldsWhileItsFileIsAway) {
  build();
  const std::filesystem::path path = folder / "a.run", away = folder / "b.run";
  ActingClock acting(clock);
  int holds = 0;
  observer.after_dwell = [&] {
    if (observer.measured.size() == 3) std::filesystem::rename(path, away);
    if (observer.measured.size() == 5) std::filesystem::remove(path);
  };
  observer.on_phase = [&](RunPhase phase) {
    if (phase != RunPhase::kHolding) return;
    ++holds;
    EXPECT_EQ(observer.measured.size(), 3U);
    EXPECT_THAT(observer.notices.back(), HasSubstr("is not at its name any more"));
    acting.at = clock.now() + std::chrono::seconds(30);
    acting.act = [&, moves = stage->moves.size()] {
      EXPECT_EQ(stage->moves.size(), moves);
      std::filesystem::rename(away, path);
    };
  };
  run_experiments(instruments(acting), {plan, settings(), {}}, *file, observer, stop.get_token());
  EXPECT_EQ(holds, 1);
  EXPECT_THAT(observer.notices, testing::Contains(HasSubstr("is at its name again")));
  EXPECT_THAT(observer.notices, testing::Contains(HasSubstr("was deleted, and has been written again")));
  EXPECT_EQ(RunFile::load(path).record.dwells.size(), plan.size());
}

TEST_F(ExperimentRunTest, LeavesOutTheAnglesThatAreMeasuredAlready) {
  build();
  std::set<std::size_t> measured;
  for (std::size_t k = 0; k < plan.size() - 3; ++k) measured.insert(k);
  run(measured);
  EXPECT_EQ(observer.measured.size(), 3U);
}

/// A run of which the first angles are measured, resumed with the data that a second program would have.
class ResumedRunTest : public ExperimentRunTest {
 protected:
  RunProgress interrupted_after(std::size_t dwells) {
    build();
    observer.after_dwell = [this, dwells] {
      if (observer.measured.size() == dwells) stop.request_stop();
    };
    EXPECT_THROW(run(), RunInterrupted);
    observer.after_dwell = {};
    stop = std::stop_source();
    const StoredRun stored = RunFile::load(folder / "a.run");
    RunProgress so_far;
    so_far.measured = {stored.measured.begin(), stored.measured.end()};
    so_far.spent = stored.timing;
    so_far.last = RunProgress::LastAngle{stored.measured.back(), {{1, stored.record.dwells.back()}}};
    return so_far;
  }
  void resume(const RunProgress& so_far) {
    run_experiments(instruments(clock), {plan, settings(), so_far}, *file, observer, stop.get_token());
  }
};

TEST_F(ResumedRunTest, MeasuresTheLastAngleAgainAndGoesOn) {
  const RunProgress so_far = interrupted_after(5);
  resume(so_far);
  const StoredRun stored = RunFile::load(folder / "a.run");
  EXPECT_EQ(stored.record.dwells.size(), plan.size());
  EXPECT_EQ(observer.measured.size(), plan.size());
  // The first measurement counts; the check of it is kept.
  for (const DwellRecord& dwell : stored.record.dwells) EXPECT_EQ(dwell.flags & kFlagRepeated, 0U);
  SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select group_concat(position) from dwell where flag_words like '%repeated%'"),
            "4");
}

TEST_F(ResumedRunTest, GoesOnInTheMiddleOfTheCheckPoses) {
  protocol.check_poses = true;
  // After the first of the two poses of the visit between experiments 1 and 2.
  const std::size_t before = [&] {
    const auto planned = make_rotation_plan(protocol, {});
    std::size_t at = 2;
    while (!planned[at].check) ++at;
    return at + 1;
  }();
  RunProgress so_far = interrupted_after(before);
  StoredRun stored = RunFile::load(folder / "a.run");
  ASSERT_EQ(stored.dwells.size(), before);
  ASSERT_EQ(stored.record.check_poses.size(), 3U);
  so_far.last->dwells[1] = stored.dwells.back();
  resume(so_far);
  stored = RunFile::load(folder / "a.run");
  EXPECT_EQ(stored.measured.size(), plan.size());
  ASSERT_EQ(stored.record.check_poses.size(), 8U);
  EXPECT_EQ(stored.record.dwells.size() + 8, plan.size());
  EXPECT_EQ(stored.record.check_poses[2].after, stored.record.check_poses[3].after);
  EXPECT_EQ(stored.record.check_poses[2].dwell.mean, so_far.last->dwells.at(1).mean)
      << "the first one counts";
  SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select count(*) from dwell where role = 'check'"), "9");
}

TEST_F(ResumedRunTest, ThePauseIsInTheTimesOfDwellsAndReadings) {
  const RunProgress so_far = interrupted_after(5);
  clock.sleep_until(clock.now() + from_seconds(45.0));
  resume(so_far);
  const StoredRun stored = RunFile::load(folder / "a.run");
  const double gap = *stored.record.dwells.at(5).time_s - *stored.record.dwells.at(4).time_s;
  EXPECT_GT(gap, 45.0);
  EXPECT_LT(gap, 75.0);
  SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select count(*) from timed_reading r join dwell d on d.id = r.dwell"
                           " where abs(r.time_s - d.time_s) > 1.0"),
            "0");
  EXPECT_LT(stored.timing.total_s(), *stored.record.dwells.back().time_s) << "only measuring counts there";
}

/// A simulated clock whose UTC a person sets while it goes.
class SettableClock final : public Clock {
 public:
  explicit SettableClock(sim::SimClock& inner) : inner_(inner) {}
  Instant now() const override { return inner_.now(); }
  UtcTime utc_now() const override { return inner_.utc_now() + moved; }
  void sleep_until(Instant instant) override { inner_.sleep_until(instant); }
  Duration moved{};

 private:
  sim::SimClock& inner_;
};

TEST_F(ExperimentRunTest, ASystemClockThatIsSetDuringTheRunIsAnEventAndMovesNoTime) {
  build();
  SettableClock settable(clock);
  observer.after_dwell = [&] {
    if (observer.measured.size() == 5) settable.moved = -std::chrono::hours(1);
  };
  run_experiments(instruments(settable), {plan, settings(), {}}, *file, observer, stop.get_token());
  file->complete(format_utc(file->utc_now(settable)), {});
  const StoredRun stored = RunFile::load(folder / "a.run");
  int steps = 0;
  for (const RunEvent& event : stored.events) steps += event.kind == kClockStepEvent ? 1 : 0;
  EXPECT_EQ(steps, 1);
  EXPECT_GT(stored.events.back().utc, format_utc(*stored.sessions.at(0).begun))
      << "complete after its beginning";
  for (std::size_t k = 1; k < stored.record.dwells.size(); ++k)
    EXPECT_GT(*stored.record.dwells[k].time_s, *stored.record.dwells[k - 1].time_s);
}

TEST_F(ResumedRunTest, RefusesToGoOnWhenTheLastAngleReadsOtherwise) {
  const RunProgress so_far = interrupted_after(5);
  // The accelerometer was taken off and put back, half a degree askew.
  sim::OutputTruth slipped = truth;
  slipped.sensitivity_matrix =
      Eigen::AngleAxisd(0.5 * std::numbers::pi / 180.0, Eigen::Vector3d::UnitX()).toRotationMatrix();
  world->change(slipped, clock.now());
  try {
    resume(so_far);
    FAIL() << "the slip was not noticed";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kImplausible);
    EXPECT_THAT(error.what(), AllOf(HasSubstr("before the interruption"), HasSubstr("begin a new run")));
  }
  const StoredRun stored = RunFile::load(folder / "a.run");
  EXPECT_EQ(stored.record.dwells.size(), 5U);
  EXPECT_EQ(stored.state, RunState::kInterrupted);
  EXPECT_EQ(stored.record.dwells.back().mean, so_far.last->dwells.at(1).mean);
}

TEST(ExplainedChange, IsFivefoldTheUncertaintyOfTheChange) {
  DwellRecord dwell;
  dwell.mean = Eigen::Vector3d(0.0, 0.0, 1.0);
  dwell.u_mean = Eigen::Vector3d::Constant(3e-3);
  Tolerances none;
  none.zero = none.step = Angle{};
  none.drift = 0.0;
  EXPECT_NEAR(explained_change(dwell, dwell, none)[0], kFalseAlarmDeviate * 3e-3 * std::sqrt(2.0), 1e-12);
  dwell.u_mean = Eigen::Vector3d::Zero();
  none.step = Angle::degrees(0.008);
  EXPECT_NEAR(explained_change(dwell, dwell, none)[2],
              kFalseAlarmDeviate * 0.008 * std::numbers::pi / 180.0 * std::sqrt(2.0), 1e-12);
}

TEST_F(ExperimentRunTest, StopsBetweenTwoLooksWhenTheOperatorSaysSo) {
  build();
  observer.after_dwell = [this] {
    if (observer.measured.size() == 5) stop.request_stop();
  };
  EXPECT_THROW(run(), RunInterrupted);
  EXPECT_EQ(stage->halts, 1);
  const StoredRun stored = RunFile::load(folder / "a.run");
  EXPECT_EQ(stored.state, RunState::kInterrupted);
  EXPECT_EQ(stored.record.dwells.size(), 5U);
  EXPECT_THAT(stored.events.back().text, HasSubstr("operator"));
}

TEST_F(ExperimentRunTest, SaysSoWhenTheStageDoesNotAcknowledgeTheHalt) {
  build();
  stage->acknowledges_halt = false;
  inject_after(2, {.kind = sim::FaultKind::kNoOutput});
  EXPECT_THAT(failure(Fault::kNoReply), HasSubstr("did not acknowledge the halt"));
}

TEST_F(ExperimentRunTest, ASilentAccelerometerEndsTheRun) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kNoOutput});
  EXPECT_THAT(failure(Fault::kNoReply), HasSubstr("no reading for 2 s"));
}

TEST_F(ExperimentRunTest, AnOutputThatSticksEndsTheRun) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kStuckOutput});
  EXPECT_THAT(failure(Fault::kImplausible), HasSubstr("stuck"));
}

TEST_F(ExperimentRunTest, ReadingsThatAreNotNumbersEndTheRun) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kNotFinite});
  EXPECT_THAT(failure(Fault::kImplausible), HasSubstr("not finite"));
}

TEST_F(ExperimentRunTest, ClippingIsFlaggedWhereItHappens) {
  truth.full_scale = 0.9;
  build();
  run();
  int clipped = 0;
  for (const DwellRecord& dwell : observer.measured) clipped += (dwell.flags & kFlagClipped) != 0;
  EXPECT_GT(clipped, 3);
  EXPECT_LT(clipped, static_cast<int>(plan.size()));
  EXPECT_GE(observer.notices.size(), static_cast<std::size_t>(clipped));
}

TEST_F(ExperimentRunTest, AnAxisThatNeverArrivesEndsTheRun) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kStalledAxis, .axis = StageAxis::kX});
  EXPECT_THAT(failure(Fault::kStalled), HasSubstr("still moving"));
}

TEST_F(ExperimentRunTest, AnAxisThatStopsOutsideTheWindowEndsTheRunWithTheDistance) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kStopsShort, .axis = StageAxis::kX, .value = 0.05});
  EXPECT_THAT(failure(Fault::kStalled), testing::AllOf(HasSubstr("stopped at"), HasSubstr("commanded 90")));
}

TEST_F(ExperimentRunTest, ALostReferenceEndsTheRun) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kLostReference, .axis = StageAxis::kX});
  EXPECT_THAT(failure(Fault::kNotReady), HasSubstr("reference"));
}

TEST_F(ExperimentRunTest, ARefusedMoveEndsTheRun) {
  build();
  inject_after(3, {.kind = sim::FaultKind::kRefusedMove, .axis = StageAxis::kX});
  failure(Fault::kRefused);
}

TEST_F(ExperimentRunTest, WaitsForTheRingDownAndFlagsWhatNeverBecomesQuiet) {
  truth.ring_down_amplitude = 1e-3;  // 0.02 R at 20 deg/s, 200 times the noise
  truth.ring_down_frequency_hz = 7.0;
  truth.ring_down_decay_s = 1.0;
  protocol.settle_s = 0.2;
  protocol.quiet_timeout_s = 30.0;
  build();
  run();
  double longest = 0.0;
  for (const DwellRecord& dwell : observer.measured) longest = std::max(longest, dwell.settle_time_s);
  EXPECT_GT(longest, 1.0);
  EXPECT_THAT(observer.notices, testing::IsEmpty());
}

TEST_F(ExperimentRunTest, FlagsAnAngleThatIsNotQuietAtTheLongestWait) {
  truth.drift_per_hour =
      Eigen::Vector3d::Constant(3600.0 * 0.05);  // 5e-4 R a reading, compared with 1e-4 R of noise
  protocol.quiet_timeout_s = 0.5;
  build();
  run();
  for (const DwellRecord& dwell : observer.measured) EXPECT_TRUE(dwell.flags & kFlagNotQuiet);
}

TEST_F(ExperimentRunTest, FlagsATemperatureOutsideItsLimits) {
  truth.temperature_degc = 30.0;
  limits.temperature_max_degc = 26.0;
  limits.temperature_wait_s = 0.0;
  build();
  run();
  for (const DwellRecord& dwell : observer.measured) EXPECT_TRUE(dwell.flags & kFlagTemperature);
}

}  // namespace
}  // namespace abcal
