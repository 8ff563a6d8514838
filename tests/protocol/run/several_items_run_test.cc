// A run over several items in the simulated world, without bench file and session.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <functional>
#include <numbers>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/experiment_run.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_bench.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

class KeepingDwells final : public RunObserver {
 public:
  void phase(std::size_t position, RunPhase phase) override {
    moves += phase == RunPhase::kMoving ? 1 : 0;
    if (phase == RunPhase::kDwelling && on_dwelling) on_dwelling(position);
  }
  void dwells(std::size_t, std::span<const ItemDwell> dwells) override { sizes.push_back(dwells.size()); }
  void notice(std::string_view kind, const Message& text, std::optional<int> item) override {
    notices.push_back(std::string(kind) + ": " + std::string(text));
    if (kind == kItemDroppedEvent) dropped.push_back(item.value());
  }
  std::function<void(std::size_t position)> on_dwelling;
  int moves = 0;
  std::vector<std::size_t> sizes;
  std::vector<std::string> notices;
  std::vector<int> dropped;
};

class SeveralItemsRunTest : public testing::Test {
 protected:
  SeveralItemsRunTest() {
    settings.protocol.steps = 4;
    settings.protocol.step = Angle::degrees(90.0);
    settings.protocol.settle_s = 0.5;
    settings.protocol.dwell_readings = 40;
    settings.protocol.check_poses = false;
    settings.protocol.closing_angle = false;
    for (std::size_t k = 0; k < 3; ++k) {
      sim::ItemTruth truth;
      truth.noise = 1e-4;
      truth.seed = sim::item_seed(1, static_cast<int>(k));
      worlds.push_back(k == 0 ? std::make_shared<sim::SimBench>(truth, sim::StageTruth{}, clock.now())
                              : worlds.front()->add_item(truth));
      accelerometers.push_back(std::make_unique<sim::SimAccelerometer>(worlds.back(), clock, rates_hz[k], "g",
                                                                       "SIM-" + std::to_string(k + 2)));
    }
  }

  /// @param items numbers of those that take part
  StoredRun run(const std::vector<int>& items) {
    sim::SimStage stage(worlds.front(), clock);
    RunInstruments instruments{stage, clock, {}, true};
    RunHeader header;
    header.plan = make_rotation_plan(settings.protocol, {});
    for (const int k : items) {
      instruments.items.push_back({k, *accelerometers[static_cast<std::size_t>(k) - 1], settings.limits,
                                   settings.tolerances, settings.expected});
      header.items.emplace_back().k = k;
      if (k > 1) header.further_items.emplace_back();
    }
    {
      RunFile file = RunFile::create(folder / "a.run", header);
      timing = run_experiments(instruments, {header.plan, settings, {}}, file, observer, {});
    }
    return RunFile::load(folder / "a.run");
  }
  StoredRun stored(int item) const { return RunFile::load(folder / "a.run", item); }
  Clock::Instant at(double seconds) const { return worlds.front()->start() + from_seconds(seconds); }

  static constexpr std::array<double, 3> rates_hz{100.0, 100.0, 250.0};
  test::TemporaryFolder folder;
  sim::SimClock clock;
  RunSettings settings;
  KeepingDwells observer;
  std::vector<std::shared_ptr<sim::SimBench>> worlds;
  std::vector<std::unique_ptr<sim::SimAccelerometer>> accelerometers;
  RunTiming timing;
};

TEST_F(SeveralItemsRunTest, AllAreReadAtOnceWithTheirOwnTimes) {
  const StoredRun first = run({1, 2, 3});
  const std::size_t planned = first.header.plan.size();
  for (const int k : {1, 2, 3}) {
    ASSERT_EQ(stored(k).dwells.size(), planned);
    for (const DwellRecord& dwell : stored(k).dwells) EXPECT_EQ(dwell.lost, 0);
  }
  // 40 readings at 100 Hz and at 250 Hz begin together: the middle of the fast ones is 120 ms earlier.
  EXPECT_NEAR(*stored(1).dwells[0].time_s - *stored(3).dwells[0].time_s, 0.12, 0.02);
  EXPECT_NEAR(*stored(1).dwells[0].time_s, *stored(2).dwells[0].time_s, 1e-9);
  EXPECT_NE(stored(1).dwells[0].mean, stored(2).dwells[0].mean) << "each has noise of its own";
  RunFile::read_dwells(folder / "a.run", [](const StoredDwell& dwell) {
    for (std::size_t k = 1; k < dwell.readings.size(); ++k) {
      EXPECT_NEAR(dwell.readings[k].time_s - dwell.readings[k - 1].time_s, dwell.item == 3 ? 0.004 : 0.01,
                  1e-6);
      EXPECT_EQ(dwell.readings[k].sequence, dwell.readings[k - 1].sequence + 1);
    }
  });
}

TEST_F(SeveralItemsRunTest, OnlyTheItemThatWasShakenIsMeasuredAgain) {
  // For most of one dwell.
  const sim::OutputTruth quiet = worlds[1]->output_truth(clock.now());
  sim::OutputTruth shaken = quiet;
  shaken.noise = 0.02;
  bool over = false;
  observer.on_dwelling = [&](std::size_t position) {
    if (position != 5 || std::exchange(over, true)) return;
    worlds[1]->change(shaken, clock.now());
    worlds[1]->change(quiet, clock.now() + from_seconds(0.35));
  };
  run({1, 2});
  const auto flagged = [](const StoredRun& run) {
    return std::ranges::count_if(run.dwells, [](const DwellRecord& dwell) {
      return (dwell.flags & (kFlagRepeated | kFlagNotQuiet)) != 0U;
    });
  };
  EXPECT_EQ(flagged(stored(1)), 0);
  EXPECT_EQ(flagged(stored(2)), 1);
  EXPECT_EQ(observer.moves, static_cast<int>(stored(1).header.plan.size()) + 1);
  EXPECT_THAT(observer.notices,
              testing::Contains(AllOf(HasSubstr("repeated: item 2, "), HasSubstr("again"))));
}

TEST_F(SeveralItemsRunTest, ASilentItemIsLeftOutAndTheOthersKeepTheAngle) {
  worlds[1]->inject({.kind = sim::FaultKind::kNoOutput, .at = at(30.0)});
  const StoredRun first = run({1, 2, 3});
  const std::size_t planned = first.header.plan.size();
  ASSERT_TRUE(first.items.at(1).dropped_at);
  const std::size_t dropped_at = *first.items.at(1).dropped_at;
  EXPECT_EQ(stored(2).dwells.size(), dropped_at);
  EXPECT_EQ(first.dwells.size(), planned);
  EXPECT_EQ(observer.moves, static_cast<int>(planned));
  EXPECT_EQ(observer.sizes.at(dropped_at), 2U);
  EXPECT_THAT(observer.dropped, ElementsAre(2));
  EXPECT_THAT(first.items.at(1).reason, AllOf(HasSubstr("item 2, accelerometer"),
                                              HasSubstr("no reading for 2 s"), HasSubstr("other 2")));
}

/// An accelerometer whose driver is held up once, as on a computer that has far more to do than it can.
class HeldUpAccelerometer final : public Accelerometer {
 public:
  HeldUpAccelerometer(Accelerometer& inner, sim::SimClock& clock) : inner_(inner), clock_(clock) {}
  AccelerometerInfo identify() override { return inner_.identify(); }
  void start() override { inner_.start(); }
  std::optional<Reading> next(Clock::Instant deadline) override {
    const bool is_look_beside_another = deadline <= clock_.now();
    if (is_look_beside_another && clock_.now() >= from) {
      held_up = true;
      from = Clock::Instant::max();
      clock_.sleep_until(clock_.now() + from_seconds(3.0));
    }
    return inner_.next(deadline);
  }
  void discard_pending() override { inner_.discard_pending(); }
  StreamHealth health() const override { return inner_.health(); }
  void stop() noexcept override { inner_.stop(); }

  Clock::Instant from;
  bool held_up = false;

 private:
  Accelerometer& inner_;
  sim::SimClock& clock_;
};

TEST_F(SeveralItemsRunTest, NoItemIsLeftOutWhileItsReadingsWaitForAProgramThatWasHeldUp) {
  // Longer than reading_timeout_s, while the first item, which makes 20 readings a second, is waited for.
  accelerometers[0] = std::make_unique<sim::SimAccelerometer>(worlds[0], clock, 20.0, "g", "SIM-2");
  sim::SimAccelerometer slow(worlds[1], clock, 20.0, "g", "SIM-3");
  HeldUpAccelerometer second(slow, clock);
  second.from = at(30.0);
  sim::SimStage stage(worlds.front(), clock);
  RunHeader header;
  header.plan = make_rotation_plan(settings.protocol, {});
  header.items.emplace_back().k = 1;
  header.items.emplace_back().k = 2;
  header.further_items.emplace_back();
  RunInstruments instruments{stage, clock, {}, true};
  instruments.items.push_back(
      {1, *accelerometers[0], settings.limits, settings.tolerances, settings.expected});
  instruments.items.push_back({2, second, settings.limits, settings.tolerances, settings.expected});
  {
    RunFile file = RunFile::create(folder / "a.run", header);
    run_experiments(instruments, {header.plan, settings, {}}, file, observer, {});
  }
  EXPECT_TRUE(second.held_up);
  EXPECT_THAT(observer.dropped, testing::IsEmpty());
  for (const int k : {1, 2}) EXPECT_EQ(stored(k).dwells.size(), header.plan.size()) << k;
}

TEST_F(SeveralItemsRunTest, AnItemThatTurnsOnItsMountEndsTheRun) {
  sim::OutputTruth loose = worlds[2]->output_truth(clock.now());
  loose.sensitivity_matrix =
      Eigen::AngleAxisd(std::numbers::pi / 2.0, Eigen::Vector3d(1, 1, 1).normalized()).toRotationMatrix();
  worlds[2]->change(loose, at(30.0));
  try {
    run({1, 2, 3});
    FAIL() << "the run did not notice";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kImplausible);
    EXPECT_THAT(error.what(), AllOf(HasSubstr("item 3"), HasSubstr("come loose")));
  }
  EXPECT_EQ(stored(1).state, RunState::kInterrupted);
}

TEST_F(SeveralItemsRunTest, SettlingByTheOutputsWaitsForTheSlowestItem) {
  settings.protocol.settle_auto = true;
  sim::OutputTruth ringing = worlds[1]->output_truth(clock.now());
  ringing.ring_down_amplitude = 2e-3;
  ringing.ring_down_frequency_hz = 3.0;
  ringing.ring_down_decay_s = 0.4;
  worlds[1]->change(ringing, worlds[1]->start());
  run({1, 2});
  for (std::size_t i = 1; i < stored(1).dwells.size(); ++i) {
    EXPECT_NEAR(stored(1).dwells[i].settle_time_s, stored(2).dwells[i].settle_time_s, 0.5) << i;
    EXPECT_GT(stored(1).dwells[i].settle_time_s, 0.8) << i;
  }
}

}  // namespace
}  // namespace abcal
