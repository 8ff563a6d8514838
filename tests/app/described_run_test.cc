// A description says the same as a driver in C++: Zaber ASCII in both, on the simulated devices that were
// written for the latter.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/stage_description_file.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/session/measuring_session.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/run_file.h"
#include "tests/app/bench_text.h"
#include "tests/app/stage_variants.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::ContainsRegex;
using testing::HasSubstr;

constexpr const char* kByDescription = "described\"\ndescription = \"zaber_ascii";

/// A bench whose readings come from the angle alone.
std::string bench_text(const std::string& stage_driver) {
  BenchText bench;
  bench.stage_driver = stage_driver;
  bench.protocol += "approach_deg = 0.0\n";
  bench.simulation = "noise_seeded_by_angle = true\nseed = 7\n";
  bench.motion = "speed_deg_per_s = 500.0\nacceleration_deg_per_s2 = 25000.0\n";
  return bench.text();
}

StoredRun run_of(const std::string& stage_driver, const std::filesystem::path& path) {
  MeasuringSession session({});
  session.start({.bench = parse_bench(bench_text(stage_driver), "bench"), .run_file = path.string()});
  return RunFile::load(path);
}

TEST(DescribedRunTest, GivesTheSameAnglesAndReadingsAsTheDriverInCpp) {
  const test::TemporaryFolder folder;
  const StoredRun driver = run_of("zaber_ascii", folder.path() / "driver.run");
  const StoredRun described = run_of(kByDescription, folder.path() / "described.run");
  ASSERT_EQ(driver.measured, described.measured);
  ASSERT_FALSE(driver.measured.empty());
  for (std::size_t k = 0; k < driver.measured.size(); ++k) {
    const DwellRecord &one = driver.record.dwells[k], &other = described.record.dwells[k];
    EXPECT_EQ(one.commanded_x, other.commanded_x);
    EXPECT_EQ(one.commanded_z, other.commanded_z);
    EXPECT_DOUBLE_EQ(one.encoder_x->deg(), other.encoder_x->deg()) << k;
    EXPECT_DOUBLE_EQ(one.encoder_z->deg(), other.encoder_z->deg()) << k;
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(one.mean[j], other.mean[j], 3e-4) << k;
  }
  // The run keeps the description, so that it can be resumed and read without its file.
  EXPECT_THAT(described.header.bench_toml, HasSubstr("get limit.cycle.dist"));
  const auto stage = std::ranges::find(described.header.instruments, "stage", &InstrumentIdentity::role);
  ASSERT_NE(stage, described.header.instruments.end());
  EXPECT_THAT(stage->details, ContainsRegex("; description zaber_ascii, SHA-256 [0-9a-f]{64}$"));
}

class EveryDescriptionTest : public testing::TestWithParam<std::string> {};

TEST_P(EveryDescriptionTest, MeasuresAWholePlanOnItsEmulator) {
  StageConfig stage;
  stage.description = GetParam();
  const StageDescription description = stage_description_of(stage);
  std::string axes;
  for (std::size_t k = 0; k < 2; ++k) {
    axes +=
        (k == 0 ? "[stage.x]\naxis = \"" : "[stage.z]\naxis = \"") + description.axis_names.at(k) + "\"\n";
    if (description.scale_in_bench)
      axes += k == 0 ? "units_per_degree = 2222.2222\n" : "units_per_degree = 2500\n";
    if (description.wraps) axes += "travel_min_deg = -185\ntravel_max_deg = 370\n";
  }
  const test::TemporaryFolder folder;
  const std::string path = (folder.path() / "described.run").string();
  MeasuringSession session({});
  session.start({.bench = parse_bench("[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"described\"\n"
                                      "port = \"simulated\"\ndescription = \"" +
                                          GetParam() + "\"\n" + axes +
                                          "[accelerometer]\ndriver = \"simulated\"\n" + quick_calibration(),
                                      "bench"),
                 .run_file = path});
  const StoredRun run = RunFile::load(path);
  EXPECT_EQ(run.state, RunState::kComplete);
  ASSERT_FALSE(run.record.dwells.empty());
  EXPECT_EQ(run.record.dwells.size(), run.header.plan.size());
  for (const DwellRecord& dwell : run.record.dwells) {
    EXPECT_NEAR(dwell.encoder_x->deg(), dwell.commanded_x.deg(), 0.01);
    EXPECT_NEAR(dwell.encoder_z->deg(), dwell.commanded_z.deg(), 0.01);
  }
}

INSTANTIATE_TEST_SUITE_P(Of, EveryDescriptionTest, testing::ValuesIn(made_up_and_shipped()),
                         [](const auto& one) { return std::filesystem::path(one.param).stem().string(); });

/// Both axes under way, then something happens; what is left is compared.
class BothDriversTest : public testing::Test {
 protected:
  struct Outcome {
    std::array<double, 2> angles{};
    HaltReport halted;
    std::optional<Fault> fault;
  };

  /// @param act  with a homed bench; its InstrumentError is the outcome's
  static Outcome of(const std::string& stage_driver, const std::function<void(Bench&, Outcome&)>& act) {
    Bench bench = make_bench(parse_bench(bench_text(stage_driver), "bench"));
    bench.stage->identify();
    for (const StageAxis axis : kStageAxes) {
      bench.stage->home(axis);
      wait(bench, axis);
    }
    Outcome outcome;
    try {
      act(bench, outcome);
    } catch (const InstrumentError& error) {
      outcome.fault = error.fault();
    }
    for (const StageAxis axis : kStageAxes)
      outcome.angles[index(axis)] = bench.world->commanded_angle(axis, bench.clock->now()).deg();
    return outcome;
  }
  static void wait(Bench& bench, StageAxis axis) {
    while (bench.stage->motion_state(axis) == MotionState::kMoving)
      bench.clock->sleep_until(bench.clock->now() + 5ms);
  }
  static void expect_same(const std::function<void(Bench&, Outcome&)>& act, double angle_tolerance = 1e-9) {
    const Outcome one = of("zaber_ascii", act), other = of(kByDescription, act);
    EXPECT_EQ(one.fault, other.fault) << (one.fault ? to_string(*one.fault) : "none") << " and "
                                      << (other.fault ? to_string(*other.fault) : "none");
    EXPECT_EQ(one.halted, other.halted);
    for (std::size_t k = 0; k < 2; ++k) EXPECT_NEAR(one.angles[k], other.angles[k], angle_tolerance) << k;
  }
  static void inject(Bench& bench, sim::FaultKind kind, StageAxis axis) {
    sim::WorldFault fault;
    fault.kind = kind;
    fault.axis = axis;
    fault.at = bench.clock->now();
    bench.world->inject(fault);
  }
};

TEST_F(BothDriversTest, MoveAndRefuseTheSame) {
  expect_same([](Bench& bench, Outcome&) {
    bench.stage->move_to(StageAxis::kX, Angle::degrees(123.4567));
    wait(bench, StageAxis::kX);
    bench.stage->set_speed(StageAxis::kZ, 20.0);
    bench.stage->move_to(StageAxis::kZ, Angle::degrees(-40.0));
    wait(bench, StageAxis::kZ);
  });
  expect_same([](Bench& bench, Outcome&) { bench.stage->move_to(StageAxis::kX, Angle::degrees(1e5)); });
}

TEST_F(BothDriversTest, HaltTheSame) {
  expect_same(
      [](Bench& bench, Outcome& outcome) {
        for (const StageAxis axis : kStageAxes) bench.stage->move_to(axis, Angle::degrees(150.0));
        outcome.halted = bench.stage->halt_axes();
        for (const StageAxis axis : kStageAxes) {
          EXPECT_FALSE(bench.world->moving(axis, bench.clock->now()));
          EXPECT_EQ(bench.stage->motion_state(axis), MotionState::kStopped);
        }
      },
      20.0);  // They sent their commands in other milliseconds, at 500 degrees/s.
}

TEST_F(BothDriversTest, ReportTheSameFaults) {
  for (const sim::FaultKind kind :
       {sim::FaultKind::kStalledAxis, sim::FaultKind::kLostReference, sim::FaultKind::kRefusedMove}) {
    SCOPED_TRACE(static_cast<int>(kind));
    expect_same(
        [kind](Bench& bench, Outcome&) {
          inject(bench, kind, StageAxis::kX);
          bench.stage->move_to(StageAxis::kX, Angle::degrees(90.0));
          wait(bench, StageAxis::kX);
        },
        5.0);
  }
}

}  // namespace
}  // namespace abcal
