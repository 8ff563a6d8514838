// abcal stage try, and runs with a described stage, as their users call them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/stage_description_file.h"
#include "app/system/exit_code.h"
#include "tests/app/program_fixtures.h"
#include "tests/app/stage_variants.h"
#include "tests/support/emulator_control.h"
#include "tests/support/project_paths.h"
#include "tests/support/typed_program.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class StageTryTest : public ProgramTest {
 protected:
  StageTryTest() { write_description(example_); }

  void write_description(const std::string& text) { test::write_file(folder / "rt2.toml", text); }
  static std::string replaced(std::string text, const std::string& what, const std::string& with) {
    const std::size_t at = text.find(what);
    EXPECT_NE(at, std::string::npos) << what;
    return at == std::string::npos ? text : text.replace(at, what.size(), with);
  }
  void write_bench_file(const std::string& name, const std::string& stage_port) {
    test::write_file(
        folder / name,
        "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"described\"\ndescription = \"rt2.toml\"\n"
        "port = \"" +
            stage_port +
            "\"\n[stage.x]\naxis = \"O\"\ntravel_min_deg = -185\ntravel_max_deg = 370\n"
            "[stage.z]\naxis = \"I\"\ntravel_min_deg = -185\ntravel_max_deg = 370\n"
            "[accelerometer]\ndriver = \"simulated\"\n[protocol]\nsettle_s = 0.5\nsteps = 12\n");
  }

  const std::string example_ = test::read_file(test::source_folder() / "docs/examples/described_stage.toml");
};

TEST_F(StageTryTest, ADescriptionAgreesWithItsEmulator) {
  const ProgramResult tried = abcal({"stage", "try", "rt2.toml"});
  EXPECT_EQ(tried.exit_code, 0) << tried.err;
  EXPECT_THAT(tried.err, AllOf(HasSubstr("no problem found, SHA-256"), HasSubstr("RT-2"),
                               HasSubstr("the halt was acknowledged"), HasSubstr("axis Z (\"I\"): passed")));
  EXPECT_THAT(test::unwrapped(tried.out), HasSubstr("agrees with its own emulator"));
}

TEST_F(StageTryTest, AllProblemsOfADescriptionAreToldAtOnce) {
  write_description(
      replaced(replaced(example_, "gap_s = 0.05", "gap_ms = 50"), "send = \"HA\"", "sent = \"HA\""));
  const ProgramResult tried = abcal({"stage", "try", "rt2.toml"});
  EXPECT_EQ(tried.exit_code, kExitUsage);
  EXPECT_THAT(tried.err, AllOf(HasSubstr("gap_ms"), HasSubstr("a stage that cannot be halted"),
                               HasSubstr("rt2.toml"), HasSubstr("line ")));
}

TEST_F(StageTryTest, APortNeedsAPersonAtATerminal) {
  const ProgramResult tried = abcal({"stage", "try", "rt2.toml", "--port", "tcp:127.0.0.1:9"});
  EXPECT_EQ(tried.exit_code, kExitUsage);
  EXPECT_THAT(tried.err, HasSubstr("a person at a terminal must watch the stage"));
}

TEST_F(StageTryTest, AStageThatPassedNoTrialIsNotDriven) {
  write_bench_file("bench.toml", "tcp:127.0.0.1:9");
  const ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run"});
  EXPECT_EQ(run.exit_code, kExitUsage) << run.err;
  EXPECT_THAT(test::unwrapped(run.err), AllOf(HasSubstr("has not been tried on a stage in its present form"),
                                              HasSubstr("abcal stage try")));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
}

TEST_F(StageTryTest, ADryRunIsMeasuredAndNeedsItsFileNoMore) {
  write_bench_file("bench.toml", "simulated");
  const ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err << run.out;
  std::filesystem::remove(folder / "rt2.toml");
  const ProgramResult verified = abcal({"verify", "a.run"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
  EXPECT_EQ(abcal({"analyse", "a.run"}).exit_code, 0);
}

class EveryDescription : public ProgramTest, public testing::WithParamInterface<std::string> {};

TEST_P(EveryDescription, IsTriedOnItsEmulator) {
  StageConfig stage;
  stage.description = GetParam();
  const StageDescription description = stage_description_of(stage);
  std::vector<std::string> command{"stage", "try", GetParam()};
  if (description.scale_in_bench) {
    const ProgramResult without = abcal(command);
    EXPECT_EQ(without.exit_code, kExitUsage);
    EXPECT_THAT(without.err, HasSubstr("--units-per-degree"));
    command.insert(command.end(), {"--units-per-degree", "222.2222,250"});
  }
  const ProgramResult tried = abcal(command);
  EXPECT_EQ(tried.exit_code, 0) << tried.err;
  EXPECT_THAT(test::unwrapped(tried.out), HasSubstr("agrees with its own emulator"));
}

INSTANTIATE_TEST_SUITE_P(Of, EveryDescription, testing::ValuesIn(made_up_and_shipped()),
                         [](const auto& one) { return std::filesystem::path(one.param).stem().string(); });

/// The emulator of the example on a pseudo-terminal, and a person at a terminal. In real time.
class StageTrialTest : public StageTryTest {
 protected:
  StageTrialTest() {
    write_bench_file("emulated.toml", "links/stage");
    emulator_ = std::make_unique<test::Program>(
        std::vector<std::string>{"emulate", "emulated.toml", "--link-dir", "links", "--control", "0"},
        folder.path());
    const auto port = [&] {
      const std::string out = emulator_->out();
      constexpr std::string_view kBefore = "control: tcp:127.0.0.1:";
      const std::size_t at = out.find(kBefore), end = out.find('\n', at);
      return end == std::string::npos ? std::string()
                                      : out.substr(at + kBefore.size(), end - at - kBefore.size());
    };
    EXPECT_TRUE(test::wait_for([&] { return !port().empty(); }, 20s)) << emulator_->out() << emulator_->err();
    control_ = std::make_unique<test::EmulatorControlClient>(static_cast<std::uint16_t>(std::stoi(port())));
  }

  std::unique_ptr<test::ProgramAtTerminal> trial(const std::string& move_deg = "10") {
    return std::make_unique<test::ProgramAtTerminal>(
        test::abcal_program(),
        std::vector<std::string>{"stage", "try", "rt2.toml", "--port", "links/stage", "--speed-deg-per-s",
                                 "20", "--move-deg", move_deg},
        folder.path(), std::map<std::string, std::string>{{"XDG_STATE_HOME", (folder / "state").string()}});
  }
  /// Types "yes" at so many questions, or at all.
  static void say_yes(test::ProgramAtTerminal& person, int questions = 1000) {
    for (std::size_t read = 0; questions > 0; --questions) {
      while (person.shown().find("Type yes: ", read) == std::string::npos)
        if (!person.read_more()) return;
      read = person.shown().find("Type yes: ", read) + 1;
      person.type("yes\n");
    }
  }

  std::unique_ptr<test::Program> emulator_;
  std::unique_ptr<test::EmulatorControlClient> control_;
};

TEST_F(StageTrialTest, APersonPassesItAndTheStageMayBeDriven) {
  const auto person = trial();
  say_yes(*person);
  EXPECT_EQ(person->wait(), 0) << person->shown();
  EXPECT_THAT(person->shown(), AllOf(HasSubstr("axis X (\"O\"): passed"), HasSubstr("axis Z (\"I\"): passed"),
                                     HasSubstr("the halt was acknowledged")));
  EXPECT_TRUE(std::filesystem::exists(folder / "state/abcal/stage-trials"));
  EXPECT_FALSE(control_->anything_moves());
}

TEST_F(StageTrialTest, CtrlCHaltsTheStageAndNothingCountsAsTried) {
  const auto person = trial("80");
  say_yes(*person, 3);  // To halt it, to search the reference, to move.
  ASSERT_TRUE(test::wait_for([&] { return control_->anything_moves(); }, 10s)) << person->shown();
  person->type("\x03");
  while (person->read_more()) continue;
  EXPECT_EQ(person->wait(), kExitInterrupted) << person->shown();
  EXPECT_FALSE(control_->anything_moves());
  EXPECT_THAT(person->shown(), HasSubstr("counts as not tried"));
  EXPECT_FALSE(std::filesystem::exists(folder / "state/abcal/stage-trials"));
}

}  // namespace
}  // namespace abcal
