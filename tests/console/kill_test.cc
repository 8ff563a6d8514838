// Programs that move a stage, and consoles, are killed at random moments: no angle is lost, and nothing is
// left moving. The emulator, a process of its own, knows what the stage does.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <random>
#include <regex>
#include <stdexcept>
#include <thread>

#include "app/console/bench_service.h"
#include "protocol/record/run_file.h"
#include "tests/app/program_fixtures.h"
#include "tests/console/client.h"
#include "tests/support/emulator_control.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::Program;
using testing::HasSubstr;
using Json = test::PageClient::Json;

const Json kStart = {{"do", "start"}, {"confirmed", true}};

class KillTest : public ProgramTest {
 protected:
  KillTest() {
    bench.stage_port = "links/stage";
    bench.accelerometer_port = "links/accelerometer";
    // Half of the time in motion; a move that nobody ends lasts 1 s and longer.
    bench.motion = "speed_deg_per_s = 30.0\nacceleration_deg_per_s2 = 2000.0\n";
  }

  void start_emulator() {
    emulator = std::make_unique<Program>(
        std::vector<std::string>{"emulate", write_bench(bench), "--link-dir", "links", "--control", "0"},
        folder.path());
    const std::regex port("control[^\n]*:(\\d+)", std::regex::icase);
    std::smatch found;
    std::string said;
    ASSERT_TRUE(test::wait_for(
        [&] {
          said = emulator->out() + emulator->err();
          return std::regex_search(said, found, port) &&
                 std::filesystem::exists(folder / "links/accelerometer");
        },
        20s))
        << said;
    control = std::make_unique<test::EmulatorControlClient>(std::stoi(found[1]));
  }

  /// Waits for `program` to move the stage, and a little longer.
  void wait_until_in_motion(std::mt19937_64& random, Program& program) {
    ASSERT_TRUE(test::wait_for([&] { return control->anything_moves() || !program.running(); }, 60s) &&
                program.running())
        << "nothing moves; " << (program.running() ? "the program runs\n" : "the program has ended\n")
        << program.out() << program.err();
    std::this_thread::sleep_for(std::chrono::milliseconds(random() % 400));  // Random moment of the kill.
  }

  /// Nothing moves from 1 s after the death on. Until then a command that was sent before it may still begin.
  void expect_that_it_stands_still(std::chrono::steady_clock::time_point died) {
    auto last_moving = died;
    while (std::chrono::steady_clock::now() < died + 1s) {
      if (control->anything_moves()) last_moving = std::chrono::steady_clock::now();
      std::this_thread::sleep_for(5ms);
    }
    slowest = std::max(slowest, std::chrono::duration_cast<std::chrono::milliseconds>(last_moving - died));
    EXPECT_FALSE(control->anything_moves()) << "moves 1 s after the death";
    // It stays at rest: a motion that had only paused would go on.
    std::this_thread::sleep_for(50ms);
    EXPECT_FALSE(control->anything_moves());
  }

  std::size_t measured(const std::filesystem::path& run) { return RunFile::load(run).measured.size(); }

  BenchText bench;
  std::unique_ptr<Program> emulator;
  std::unique_ptr<test::EmulatorControlClient> control;
  std::chrono::milliseconds slowest{0};
};

/// `abcal run`, killed while the stage turns.
class KilledRunTest : public KillTest {
 protected:
  void kill_runs(int times) {
    start_emulator();
    std::mt19937_64 random(20261123);
    const std::filesystem::path path = folder / "killed.run";
    std::size_t kept = 0;
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      const bool resumes = std::filesystem::exists(path);
      Program run(resumes ? std::vector<std::string>{"resume", "killed.run"}
                          : std::vector<std::string>{"run", "bench.toml", "-o", "killed.run"},
                  folder.path());
      const std::size_t wanted = kept + (random() % 3 == 0 ? 1 : 0);
      ASSERT_TRUE(test::wait_for(
          [&] { return !run.running() || (std::filesystem::exists(path) && measured(path) >= wanted); },
          60s));
      ASSERT_TRUE(run.running()) << run.err();
      wait_until_in_motion(random, run);
      run.signal(SIGKILL);
      const auto died = std::chrono::steady_clock::now();
      run.wait();
      expect_that_it_stands_still(died);
      const std::size_t now = measured(path);
      EXPECT_GE(now, kept);
      kept = now;
    }
    Program rest({"resume", "killed.run"}, folder.path());
    EXPECT_TRUE(test::wait_for([&] { return measured(path) > kept; }, 60s)) << rest.err();
    rest.signal(SIGINT);
    EXPECT_EQ(rest.wait(), 130) << rest.err();
    EXPECT_FALSE(control->anything_moves());
    fmt::print("{} killed runs: the stage stood still after {} ms at the latest\n", times, slowest.count());
  }
};

TEST_F(KilledRunTest, LeavesNothingMovingAndLosesNothing) {
  kill_runs(3);
}

using LongKilledRunTest = KilledRunTest;
TEST_F(LongKilledRunTest, LeavesNothingMovingAndLosesNothing) {
  bench.protocol = "steps = 72\nstep_deg = 5.0\nsettle_s = 0.05\ndwell_readings = 10\n";
  bench.motion = "speed_deg_per_s = 5.0\nacceleration_deg_per_s2 = 2000.0\n";
  kill_runs(50);
}

TEST_F(KillTest, ACheckAndALevellingAreGuardedAsWell) {
  start_emulator();
  std::mt19937_64 random(20261124);
  for (const char* command : {"check", "level"}) {
    SCOPED_TRACE(command);
    Program moving({command, "bench.toml"}, folder.path());
    wait_until_in_motion(random, moving);
    moving.signal(SIGKILL);
    const auto died = std::chrono::steady_clock::now();
    moving.wait();
    expect_that_it_stands_still(died);
  }
}

/// `abcal serve` and the process that holds its bench.
class KilledConsoleTest : public KillTest {
 protected:
  KilledConsoleTest() { std::filesystem::create_directories(folder / "runs"); }
  ~KilledConsoleTest() override {
    if (server) {
      server->signal(SIGINT);  // Ends the process that holds the bench as well.
      server->wait();
    }
  }

  void start_console() {
    server = std::make_unique<Program>(
        std::vector<std::string>{"serve", "bench.toml", "--runs", "runs", "--port", "0"}, folder.path());
    std::smatch found;
    std::string said;
    ASSERT_TRUE(test::wait_for(
        [&] {
          said = server->out();
          return std::regex_search(said, found, std::regex("http://[^:]*:(\\d+)/"));
        },
        20s))
        << server->err();
    port = static_cast<std::uint16_t>(std::stoi(found[1]));
  }

  /// A page that steers, after the state of the bench.
  std::unique_ptr<test::PageClient> page_that_steers() {
    auto page = std::make_unique<test::PageClient>(port);
    snapshot = page->wait_for_type("snapshot");
    EXPECT_TRUE(page->ok({{"do", "control"}}));
    return page;
  }
  pid_t holder() {
    return std::stoi(test::read_file(
        console::default_bench_socket({"bench.toml", folder / "runs", 1.0}).string() + ".lock"));
  }
  std::filesystem::path only_run() {
    std::filesystem::path run;
    for (const auto& entry : std::filesystem::directory_iterator(folder / "runs"))
      if (entry.path().extension() == ".run") run = entry.path();
    return run;
  }

  /// @param longest_life_ms  longest life of a console
  void kill_servers(int times, int longest_life_ms) {
    start_emulator();
    start_console();
    auto page = page_that_steers();
    ASSERT_TRUE(page->ok(kStart));
    page->wait_for_type("dwell_done");
    std::mt19937_64 random(20261125);
    std::size_t seen = 1;
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      std::this_thread::sleep_for(std::chrono::milliseconds(random() % longest_life_ms));
      server->signal(SIGKILL);
      server->wait();
      page.reset();
      std::this_thread::sleep_for(std::chrono::milliseconds(random() % 100));
      start_console();
      page = page_that_steers();
      // The run has gone on meanwhile, and its new console knows its complete state.
      ASSERT_EQ(snapshot["activity"]["activity"], "running") << snapshot["run"]["ended"];
      EXPECT_GE(snapshot["run"]["measured"].size(), seen);
      seen = snapshot["run"]["measured"].size();
    }
    // The rest of the run takes minutes, an angle some seconds.
    Json ended;
    do
      ended = page->wait_for(
          [](const Json& m) { return m["type"] == "dwell_done" || m["type"] == "finished"; }, "an angle");
    while (ended["type"] != "finished");
    EXPECT_TRUE(ended["complete"].get<bool>()) << ended;
    const StoredRun run = RunFile::load(only_run());
    EXPECT_EQ(run.state, RunState::kComplete);
    EXPECT_EQ(run.record.continuations, 0) << "it was never interrupted";
    EXPECT_EQ(run.measured.size(), run.header.plan.size());
    fmt::print("{} killed consoles: all {} angles were measured, {} of them when the last was killed\n",
               times, run.measured.size(), seen);
  }

  void kill_holders(int times) {
    start_emulator();
    start_console();
    auto page = page_that_steers();
    ASSERT_TRUE(page->ok(kStart));
    std::mt19937_64 random(20261126);
    std::size_t kept = 0;
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      wait_until_in_motion(random, *server);
      ::kill(holder(), SIGKILL);
      expect_that_it_stands_still(std::chrono::steady_clock::now());
      // The page is informed, and then by the next process of the interrupted run; nothing moves by itself.
      page->wait_for([](const Json& m) { return m["type"] == "bench" && m["state"] == "gone"; }, "its death");
      const Json after = page->wait_for_type("snapshot");
      EXPECT_EQ(after["activity"]["activity"], "idle");
      ASSERT_TRUE(after["interrupted"].is_object());
      const std::string file = after["interrupted"]["file"];
      EXPECT_EQ(file, only_run().filename());
      EXPECT_NE(after["interrupted"]["angle"], "");
      EXPECT_EQ(after["interrupted"]["measured"], measured(only_run()));
      EXPECT_GE(measured(only_run()), kept);
      kept = measured(only_run());
      EXPECT_FALSE(control->anything_moves());
      ASSERT_TRUE(page->ok({{"do", "resume"}, {"run", file}, {"confirmed", true}}));
      page->wait_for(
          [](const Json& m) {
            if (m["type"] == "log" && m["line"]["grade"] == "problem")
              throw std::runtime_error(m["line"]["text"].get<std::string>());
            return m["type"] == "snapshot" && m["run"].is_object();
          },
          "the run");
    }
    ASSERT_TRUE(page->ok({{"do", "stop"}}));
    fmt::print("{} killed holders: the stage stood still after {} ms at the latest\n", times,
               slowest.count());
  }

  std::unique_ptr<Program> server;
  std::uint16_t port = 0;
  Json snapshot;
};

TEST_F(KilledConsoleTest, ARunGoesOnAndTheNextConsoleFindsIt) {
  bench.motion = BenchText().motion;
  kill_servers(3, 100);
}

TEST_F(KilledConsoleTest, TheGuardHaltsTheStageOfADeadHolderAndTheRunCanBeResumed) {
  kill_holders(2);
}

using LongKilledConsoleTest = KilledConsoleTest;
TEST_F(LongKilledConsoleTest, ARunGoesOnAndTheNextConsoleFindsIt) {
  bench.protocol = "steps = 36\nstep_deg = 10.0\nsettle_s = 0.05\ndwell_readings = 40\n";
  kill_servers(50, 1500);
}
TEST_F(LongKilledConsoleTest, TheGuardHaltsTheStageOfADeadHolderAndTheRunCanBeResumed) {
  bench.protocol = "steps = 72\nstep_deg = 5.0\nsettle_s = 0.05\ndwell_readings = 10\n";
  kill_holders(50);
}

TEST_F(KilledConsoleTest, AStopIsConfirmedForEachAxisWithinHalfASecond) {
  start_emulator();
  start_console();
  auto page = page_that_steers();
  std::mt19937_64 random(20261127);
  double slowest_s = 0.0;
  for (int k = 0; k < 5; ++k) {
    SCOPED_TRACE(k);
    const Json resume = {{"do", "resume"}, {"run", only_run().filename().string()}, {"confirmed", true}};
    ASSERT_TRUE(page->ok(k == 0 ? kStart : resume));
    wait_until_in_motion(random, *server);
    const auto asked = std::chrono::steady_clock::now();
    ASSERT_TRUE(page->ok({{"do", "stop"}}));
    const Json halt = page->wait_for_type("halt");
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - asked;
    EXPECT_EQ(halt["axes"]["x"], "halted");
    EXPECT_EQ(halt["axes"]["z"], "halted");
    EXPECT_LE(took.count(), 0.5) << halt;
    EXPECT_FALSE(control->anything_moves());
    slowest_s = std::max(slowest_s, took.count());
    page->wait_for_activity("idle");
  }
  fmt::print("5 stops: both axes were confirmed after {:.0f} ms at the latest\n", 1e3 * slowest_s);
}

TEST_F(KilledConsoleTest, StopReachesTheGuardOfAHolderThatHangs) {
  bench.motion = "speed_deg_per_s = 5.0\nacceleration_deg_per_s2 = 2000.0\n";
  start_emulator();
  start_console();
  auto page = page_that_steers();
  ASSERT_TRUE(page->ok(kStart));
  page->wait_for_type("dwell_done");
  std::mt19937_64 random(20261128);
  wait_until_in_motion(random, *server);
  ::kill(holder(), SIGSTOP);
  const auto asked = std::chrono::steady_clock::now();
  EXPECT_TRUE(page->ok({{"do", "stop"}}));
  EXPECT_LE(std::chrono::steady_clock::now() - asked, 1s);
  EXPECT_FALSE(control->anything_moves());
  const Json known = page->wait_for(
      [](const Json& m) { return m["type"] == "guard" && m["axes"]["x"]["state"] == "at rest"; },
      "the rest of the axes");
  EXPECT_THAT(known["halted"].get<std::string>(), HasSubstr("stopped by"));
  ::kill(holder(), SIGCONT);
  page->wait_for_activity("idle");
  EXPECT_EQ(RunFile::load(only_run()).state, RunState::kInterrupted);
}

TEST_F(KilledConsoleTest, AConsoleThatIsStoppedByItsServiceLeavesTheRunAlone) {
  start_emulator();
  start_console();
  auto page = page_that_steers();
  ASSERT_TRUE(page->ok(kStart));
  page->wait_for_type("dwell_done");
  server->signal(SIGTERM);
  EXPECT_EQ(server->wait(), 0);
  const std::size_t then = measured(only_run());
  EXPECT_TRUE(test::wait_for([&] { return measured(only_run()) > then; }, 20s));
  start_console();
  server->signal(SIGINT);  // A person at the terminal ends it all.
  EXPECT_EQ(server->wait(), 130);
  EXPECT_EQ(RunFile::load(only_run()).state, RunState::kInterrupted);
  EXPECT_FALSE(control->anything_moves());
}

}  // namespace
}  // namespace abcal
