// State of a run, and of each axis, after the stage is lost or halted by something other than the run.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "app/analysed_run/run_session.h"
#include "app/measure/bench/stage_watchdog.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"
#include "sim/faults.h"
#include "sim/sim_clock.h"
#include "tests/app/instrument_cases.h"
#include "tests/app/repeatable_run.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

/// The texts of the events of a kind in a run file.
std::vector<std::string> texts(const std::filesystem::path& run, const std::string& kind) {
  std::vector<std::string> found;
  for (const RunEvent& event : RunFile::load(run).events)
    if (event.kind == kind) found.push_back(event.text);
  return found;
}

/// Two controllers, one of which is unplugged while the axis of the other turns.
class LostControllerTest : public testing::TestWithParam<StageAxis> {
 protected:
  static std::string bench() {
    StageCase two;
    for (const StageCase& one : stages())
      if (one.name == "two_controllers") two = one;
    std::string text = bench_text(two, accelerometers().front(), "", "simulated", "simulated", "simulated");
    const std::string protocol = "[protocol]\n";
    return text.insert(text.find(protocol) + protocol.size(), "replug_timeout_s = 1.0\n");
  }

  Bench open(const BenchConfig& config, BenchStreams streams) {
    auto sim_clock = std::make_unique<sim::SimClock>();
    clock = sim_clock.get();
    streams.wrap = [this](std::string_view role, BenchStreams::Stream opened, const Clock&) {
      auto link =
          std::make_unique<sim::FaultyStream>(std::move(opened), *clock, std::vector<sim::WireFault>{});
      links[std::string(role)] = link.get();
      return link;
    };
    Bench bench = make_bench(config, std::move(streams), std::move(sim_clock));
    world = bench.world;
    return bench;
  }

  /// Begins to turn the axis that is left, 150 degrees away, and unplugs the controller of the other one.
  void unplug(StageAxis lost, StageAxis left) {
    world->set_motion_limits(left, {.speed_deg_per_s = 10.0, .acceleration_deg_per_s2 = 100.0});
    turned_from = world->commanded_angle(left, clock->now());
    world->move(left, turned_from + Angle::degrees(150.0), clock->now());
    links.at(lost == StageAxis::kX ? "stage-x" : "stage-z")->add({.kind = sim::FaultKind::kUnplug});
    unplugged = clock->now();
  }

  test::TemporaryFolder folder;
  sim::SimClock* clock = nullptr;
  std::shared_ptr<sim::SimBench> world;
  std::map<std::string, sim::FaultyStream*> links;
  Angle turned_from;
  std::optional<Clock::Instant> unplugged;
};

TEST_P(LostControllerTest, TheOtherAxisIsHaltedAtOnceAndTheRunFileSaysWhatBecameOfEach) {
  const StageAxis lost = GetParam();
  const StageAxis left = lost == StageAxis::kX ? StageAxis::kZ : StageAxis::kX;
  // The first angle for which the run commands only the axis that will be lost.
  const int experiment = lost == StageAxis::kX ? 1 : 3;
  std::size_t measured_there = 0;
  std::string told;
  bool still_turning = true;
  RunSession::Options options;
  options.open_bench = [this](const BenchConfig& config, BenchStreams streams) {
    return open(config, std::move(streams));
  };
  std::vector<PlannedAngle> plan;
  options.listener = [&](const SessionEvent& event) {
    if (const auto* began = std::get_if<RunBeganEvent>(&event)) plan = began->plan;
    const auto* phase = std::get_if<PhaseEvent>(&event);
    if (phase != nullptr && phase->phase == RunPhase::kMoving && !unplugged &&
        plan.at(phase->position).experiment == experiment && ++measured_there == 3) {
      unplug(lost, left);
    }
    if (const auto* port = std::get_if<PortLostEvent>(&event); port != nullptr && told.empty()) {
      told = port->text;
      still_turning = world->moving(left, clock->now());
    }
  };
  RunSession session(std::move(options));
  EXPECT_THROW(session.start({parse_bench(bench(), "bench.toml"), (folder / "a.run").string()}),
               InstrumentError);

  ASSERT_TRUE(unplugged);
  EXPECT_FALSE(still_turning);
  // 2 s at 10 deg/s: the halt is sent at once, and not after the wait for the port that is gone.
  EXPECT_LT((world->commanded_angle(left, clock->now()) - turned_from).deg(), 20.0);
  const std::string each = lost == StageAxis::kX ? "axis X: unreachable, may be moving; axis Z: halted"
                                                 : "axis X: halted; axis Z: unreachable, may be moving";
  EXPECT_THAT(told, AllOf(HasSubstr(each), HasSubstr("stop it by its own switch")));
  EXPECT_THAT(texts(folder / "a.run", "lost"), Contains(HasSubstr(each)));
  EXPECT_THAT(RunFile::load(folder / "a.run").events.back().text, HasSubstr(each));
}

INSTANTIATE_TEST_SUITE_P(EachAxis, LostControllerTest, testing::ValuesIn(kStageAxes),
                         [](const auto& axis) { return std::string(to_string(axis.param)); });

/// Two controllers in a daisy chain, one of which is cut off while the axis of the other turns.
class LostInAChainTest : public testing::TestWithParam<std::tuple<std::string, StageAxis>> {
 protected:
  Bench open(const BenchConfig& config, BenchStreams streams) {
    Bench bench = make_bench(config, std::move(streams));
    stage = bench.stage.get();
    clock = bench.clock.get();
    world = bench.world;
    return bench;
  }

  /// Begins to turn the axis that is left, 150 degrees away, and cuts off the controller of the other one.
  void cut_off(StageAxis lost, StageAxis left) {
    world->set_motion_limits(left, {.speed_deg_per_s = 10.0, .acceleration_deg_per_s2 = 100.0});
    turned_from = world->commanded_angle(left, clock->now());
    const double away = turned_from.deg() > 0.0 ? -150.0 : 150.0;
    stage->move_to(left, turned_from + Angle::degrees(away));
    world->inject({.kind = sim::FaultKind::kLostController, .at = clock->now(), .axis = lost});
    cut = clock->now();
  }

  test::TemporaryFolder folder;
  RotationStage* stage = nullptr;
  Clock* clock = nullptr;
  std::shared_ptr<sim::SimBench> world;
  Angle turned_from;
  std::optional<Clock::Instant> cut;
};

TEST_P(LostInAChainTest, TheOtherAxisIsHaltedAndTheRunFileSaysWhatBecameOfEach) {
  const std::string& name = std::get<0>(GetParam());
  const StageAxis lost = std::get<1>(GetParam());
  const StageAxis left = lost == StageAxis::kX ? StageAxis::kZ : StageAxis::kX;
  const int experiment =
      lost == StageAxis::kX ? 1 : 3;  // One in which the run commands only the axis that is lost.
  const auto chain =
      std::find_if(stages().begin(), stages().end(), [&](const StageCase& one) { return one.name == name; });
  std::size_t measured_there = 0;
  std::vector<PlannedAngle> plan;
  RunSession::Options options;
  options.open_bench = [this](const BenchConfig& config, BenchStreams streams) {
    return open(config, std::move(streams));
  };
  options.listener = [&](const SessionEvent& event) {
    if (const auto* began = std::get_if<RunBeganEvent>(&event)) plan = began->plan;
    const auto* phase = std::get_if<PhaseEvent>(&event);
    if (phase != nullptr && phase->phase == RunPhase::kMoving && !cut &&
        plan.at(phase->position).experiment == experiment && ++measured_there == 3) {
      cut_off(lost, left);
    }
  };
  RunSession session(std::move(options));
  const std::string bench =
      bench_text(*chain, accelerometers().front(), "simulated", "simulated", "simulated", "simulated");
  const std::string each = lost == StageAxis::kX ? "axis X: unreachable, may be moving; axis Z: halted"
                                                 : "axis X: halted; axis Z: unreachable, may be moving";
  try {
    session.start({parse_bench(bench, "bench.toml"), (folder / "a.run").string()});
    FAIL() << "the run did not end";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kNoReply) << error.what();
    EXPECT_THAT(error.what(), AllOf(HasSubstr(each), HasSubstr("stop it by its own switch")));
  }
  ASSERT_TRUE(cut);
  EXPECT_THAT(RunFile::load(folder / "a.run").events.back().text, HasSubstr(each));
  // The driver's patience with a silent controller, twice 2 s, at 10 deg/s; not the 150 degrees.
  EXPECT_LT(std::abs((world->commanded_angle(left, *cut + 1h) - turned_from).deg()), 60.0);
}

INSTANTIATE_TEST_SUITE_P(EachChain, LostInAChainTest,
                         testing::Combine(testing::Values("pi_chain", "zaber_chain"),
                                          testing::ValuesIn(kStageAxes)),
                         [](const auto& one) {
                           return std::get<0>(one.param) + "_" +
                                  std::string(to_string(std::get<1>(one.param)));
                         });

/// Hangs in the middle of a move until it is halted; then its exchange fails because of the halt, as a
/// driver's does.
class HangingStage final : public RotationStage {
 public:
  HangingStage(std::unique_ptr<RotationStage> inner, int hang_at_call)
      : inner_(std::move(inner)), hang_at_call_(hang_at_call) {}

  StageInfo identify() override { return inner_->identify(); }
  void home(StageAxis axis) override { inner_->home(axis); }
  void move_to(StageAxis axis, Angle target) override { inner_->move_to(axis, target); }
  MotionState motion_state(StageAxis axis) override {
    if (++calls_ == hang_at_call_) {
      std::unique_lock lock(mutex_);
      // 30 s: only where the watchdog does not bark at all.
      halted_changed_.wait_for(lock, 30s, [this] { return halted_; });
      throw InstrumentError("stage", Fault::kNotReady, "the stage is being halted");
    }
    return inner_->motion_state(axis);
  }
  Angle encoder_angle(StageAxis axis) override { return inner_->encoder_angle(axis); }
  bool halt() noexcept override {
    const bool acknowledged = inner_->halt();
    const std::lock_guard lock(mutex_);
    halted_ = true;
    halted_changed_.notify_all();
    return acknowledged;
  }

 private:
  std::unique_ptr<RotationStage> inner_;
  const int hang_at_call_;
  int calls_ = 0;
  std::mutex mutex_;
  std::condition_variable halted_changed_;
  bool halted_ = false;
};

TEST(WatchdogInARun, ItsHaltIsAnEventOfTheRunFileAndTheReasonIsTheFirstCause) {
  const test::TemporaryFolder folder;
  RealClock real_clock;
  RunSession::Options options;
  options.open_bench = [&](const BenchConfig& config, BenchStreams streams) {
    Bench bench = make_bench(config, std::move(streams));
    bench.stage = std::make_unique<StageWatchdog>(std::make_unique<HangingStage>(std::move(bench.stage), 40),
                                                  real_clock, 500ms);
    return bench;
  };
  RunSession session(std::move(options));
  const std::filesystem::path path = folder / "a.run";
  try {
    session.start({parse_bench(repeatable_bench().text(), "bench.toml"), path.string()});
    FAIL() << "the run did not end";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kStalled);
    EXPECT_THAT(error.what(), HasSubstr("the watchdog halted the stage"));
  }
  const StoredRun stored = RunFile::load(path);
  EXPECT_EQ(stored.state, RunState::kInterrupted);
  EXPECT_THAT(texts(path, "watchdog halt"), testing::ElementsAre(HasSubstr("had not answered for 0.5 s")));
  EXPECT_THAT(stored.events.back().text,
              AllOf(HasSubstr("the watchdog halted the stage"), HasSubstr("the stage is halted"),
                    Not(HasSubstr("is being halted"))));
}

}  // namespace
}  // namespace abcal
