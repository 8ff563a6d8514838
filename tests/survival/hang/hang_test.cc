// A program that moves a stage hangs or dies, its guard dies, or the port is gone for a while: the stage is
// at rest within 1.25 s of the fault or of the port's return. The emulator, a process of its own, knows the
// motion of the stage.

#include <dirent.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/ptrace.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <random>
#include <regex>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/operate/bench/halt_guard.h"
#include "protocol/record/run_file.h"
#include "tests/app/instrument_cases.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/emulator_control.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::Program;
using testing::HasSubstr;
using testing::Not;
using SteadyTime = std::chrono::steady_clock::time_point;

/// From the fault, or from the return of the port, until the stop bytes are on the wire.
constexpr std::chrono::milliseconds kLimit = 1250ms;
/// The emulated axes need 2.5 ms from 5 deg/s; the status of the emulator may be asked late.
constexpr std::chrono::milliseconds kDeceleration = 50ms;

enum class Injection {
  kStopRun,     ///< SIGSTOP of the whole program.
  kStopThread,  ///< Its measuring thread alone stands still.
  kKillRun,
  kKillGuard,
  kStopGuard,
  kUnplug,         ///< The port is gone for 2 s, in motion.
  kUnplugAndKill,  ///< The port is gone for 2 s, and the program is killed meanwhile.
  kFreezeBoth,     ///< Program and guard stand still for 2 s, as in a frozen container.
  kBabble,         ///< Killed, and the controller answers with a line of 60 000 bytes first.
};

std::string name_of(Injection injection) {
  switch (injection) {
    case Injection::kStopRun:
      return "stop_run";
    case Injection::kStopThread:
      return "stop_thread";
    case Injection::kKillRun:
      return "kill_run";
    case Injection::kKillGuard:
      return "kill_guard";
    case Injection::kStopGuard:
      return "stop_guard";
    case Injection::kUnplug:
      return "unplug";
    case Injection::kUnplugAndKill:
      return "unplug_and_kill";
    case Injection::kFreezeBoth:
      return "freeze_both";
    case Injection::kBabble:
      return "babble";
  }
  return "";
}

/// The guard that a program has started; -1: none.
pid_t guard_of(pid_t owner) {
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    std::ifstream stat(entry.path() / "stat");
    std::string text;
    std::getline(stat, text);
    const std::size_t end = text.rfind(')');
    if (end == std::string::npos || text.find("(abcal-guard)") == std::string::npos) continue;
    std::istringstream rest(text.substr(end + 2));
    char state = 0;
    pid_t parent = 0;
    rest >> state >> parent;
    if (parent == owner && state != 'Z') return std::stoi(entry.path().filename());
  }
  return -1;
}

class HangTest : public ProgramTest {
 protected:
  HangTest() { ::setenv("XDG_STATE_HOME", (folder / "state").c_str(), 1); }

  void start_emulator(const std::string& stage) {
    const StageCase* found = nullptr;
    for (const StageCase& one : stages())
      if (one.name == stage) found = &one;
    ASSERT_NE(found, nullptr) << stage;
    const bool tcp = stage == "newport_xps";
    const auto text = [&](const std::string& port, const std::string& x, const std::string& z,
                          const std::string& accelerometer) {
      const AccelerometerCase* mip = nullptr;
      for (const AccelerometerCase& one : accelerometers())
        if (one.name == "microstrain_mip") mip = &one;
      std::string bench = bench_text(*found, *mip, port, x, z, accelerometer);
      bench = replaced(bench, "speed_deg_per_s = 700.0", "speed_deg_per_s = 5.0");
      bench = replaced(bench, "acceleration_deg_per_s2 = 20000.0", "acceleration_deg_per_s2 = 2000.0");
      return replaced(bench, "[protocol]\n", "[protocol]\nreplug_timeout_s = 20.0\n");
    };
    const std::string any = tcp ? "tcp:127.0.0.1:0" : "links/none";
    test::write_file(folder / "emulated.toml", text(any, any, "links/another", "links/none"));
    emulator = std::make_unique<Program>(
        std::vector<std::string>{"emulate", "emulated.toml", "--link-dir", "links", "--control", "0"},
        folder.path());
    std::smatch control_port;
    std::string said;
    ASSERT_TRUE(test::wait_for(
        [&] {
          said = emulator->out() + emulator->err();
          return said.find("Serving") != std::string::npos &&
                 std::regex_search(said, control_port, std::regex("control[^\n]*:(\\d+)", std::regex::icase));
        },
        20s))
        << said;
    control = std::make_unique<test::EmulatorControlClient>(std::stoi(control_port[1]));
    const auto address = [&](const std::string& instrument) {
      const std::string out = "\n" + emulator->out();
      const std::size_t at = out.find("\n" + instrument + ": ");
      if (at == std::string::npos) return std::string("none");
      const std::size_t on = out.find(" on ", at) + 4;
      return out.substr(on, out.find('\n', on) - on);
    };
    test::write_file(folder / "bench.toml", text(address("stage"), address("stage-x"), address("stage-z"),
                                                 address("accelerometer")));
    port_of_x = stage == "two_controllers" ? "stage-x" : "stage";
  }

  std::size_t measured(const std::filesystem::path& file) {
    try {
      return std::filesystem::exists(file) ? RunFile::load(file).measured.size() : 0;
    } catch (const RunFileError&) {  // Not written yet.
      return 0;
    }
  }

  /// Starts a run and waits until the stage turns by the step of the plan (6 s), and a random time longer.
  void start_in_motion(std::mt19937_64& random) {
    const std::string file = fmt::format("run-{}.run", ++runs);
    run = std::make_unique<Program>(std::vector<std::string>{"run", "bench.toml", "-o", file}, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return measured(folder / file) > 0 || !run->running(); }, 60s));
    ASSERT_TRUE(test::wait_for([&] { return control->anything_moves() || !run->running(); }, 20s));
    ASSERT_TRUE(run->running()) << run->err() << run->out();
    std::this_thread::sleep_for(std::chrono::milliseconds(300 + random() % 500));
    ASSERT_TRUE(control->anything_moves());
    guard = guard_of(run->pid());
    ASSERT_GT(guard, 0) << "no guard; " << run->err();
  }

  /// @return the time from which the limit counts: of the fault, or of the return of the port
  SteadyTime inject(Injection injection) {
    auto from = std::chrono::steady_clock::now();
    const auto unplug = [&] {
      control->ask({{"do", "fault"}, {"kind", "unplug"}, {"instrument", port_of_x}, {"for_s", 2.0}});
    };
    switch (injection) {
      case Injection::kStopRun:
        run->signal(SIGSTOP);
        break;
      case Injection::kStopThread:
        EXPECT_EQ(::ptrace(PTRACE_SEIZE, run->pid(), nullptr, nullptr), 0);
        EXPECT_EQ(::ptrace(PTRACE_INTERRUPT, run->pid(), nullptr, nullptr), 0);
        break;
      case Injection::kKillRun:
        run->signal(SIGKILL);
        break;
      case Injection::kKillGuard:
        ::kill(guard, SIGKILL);
        break;
      case Injection::kStopGuard:
        ::kill(guard, SIGSTOP);
        break;
      case Injection::kUnplug:
        unplug();
        from += 2s;
        break;
      case Injection::kUnplugAndKill:
        unplug();
        run->signal(SIGKILL);
        from += 2s;
        break;
      case Injection::kFreezeBoth:
        run->signal(SIGSTOP);
        ::kill(guard, SIGSTOP);
        std::this_thread::sleep_for(2s);  // The freeze: the test.
        EXPECT_TRUE(control->anything_moves()) << "nobody can halt it meanwhile";
        ::kill(guard, SIGCONT);
        run->signal(SIGCONT);
        from = std::chrono::steady_clock::now();
        break;
      case Injection::kBabble:
        control->ask({{"do", "fault"},
                      {"kind", "replaced-reply"},
                      {"instrument", port_of_x},
                      {"text", std::string(60'000, 'x')},
                      {"for_s", 0.5}});
        run->signal(SIGKILL);
        break;
    }
    return from;
  }

  /// The stage is at rest from the limit on, and does not start again.
  void expect_at_rest_after(SteadyTime from, std::chrono::milliseconds limit) {
    SteadyTime last_moving = from;
    while (std::chrono::steady_clock::now() < from + limit) {
      if (control->anything_moves()) last_moving = std::chrono::steady_clock::now();
      std::this_thread::sleep_for(5ms);
    }
    EXPECT_FALSE(control->anything_moves()) << "moves " << limit.count() << " ms after the fault";
    slowest = std::max(slowest, std::chrono::duration_cast<std::chrono::milliseconds>(last_moving - from));
    std::this_thread::sleep_for(100ms);
    EXPECT_FALSE(control->anything_moves()) << "moves again";
  }

  void end_run(Injection injection) {
    std::this_thread::sleep_for(std::exchange(thaw_after, 0s));
    if (injection == Injection::kStopThread) ::ptrace(PTRACE_DETACH, run->pid(), nullptr, nullptr);
    run->signal(SIGCONT);
    if (injection == Injection::kUnplug) {  // It goes on by itself when the port is back.
      run->signal(SIGINT);
      run->wait();
      return;
    }
    const int code = run->wait();
    if (injection == Injection::kStopRun || injection == Injection::kStopThread ||
        injection == Injection::kKillGuard || injection == Injection::kStopGuard ||
        injection == Injection::kFreezeBoth) {
      EXPECT_EQ(code, 3) << run->err();
      EXPECT_THAT(run->err(), HasSubstr("guard")) << "the reason";
      EXPECT_THAT(run->err(), HasSubstr("resume"));
      EXPECT_THAT(run->err(), Not(HasSubstr("may be moving"))) << "the guard has confirmed the rest";
    }
    if (injection == Injection::kStopGuard) ::kill(guard, SIGKILL);
  }

  void inject_and_expect_rest(const std::string& stage, Injection injection, int times) {
    start_emulator(stage);
    if (HasFatalFailure()) return;
    std::mt19937_64 random(20261125 + static_cast<unsigned>(injection));
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      start_in_motion(random);
      if (HasFatalFailure()) return;
      const SteadyTime from = inject(injection);
      // Longer than the patience of the watchdog, which then also halts: the results of both must agree.
      if (injection == Injection::kStopRun && k == 0) thaw_after = 6s;
      const auto babble = injection == Injection::kBabble ? 500ms : 0ms;
      if (injection ==
          Injection::kUnplug) {  // The run goes on by itself, but only once the axes were at rest.
        std::this_thread::sleep_until(from);
        EXPECT_TRUE(test::wait_for([&] { return !control->anything_moves(); }, kLimit + kDeceleration));
        end_run(injection);
        continue;
      }
      expect_at_rest_after(from, kLimit + kDeceleration + babble);
      end_run(injection);
      // The next run finds the ports free.
      ASSERT_TRUE(test::wait_for([&] { return ::kill(guard, 0) != 0 || guard_of(run->pid()) < 0; }, 20s));
    }
    if (HasFailure()) fmt::print("{}", test::read_file(folder / "state/abcal/motion.log"));
    fmt::print("{} {}: {} times, at rest after {} ms at the latest\n", stage, name_of(injection), times,
               slowest.count());
  }

  std::unique_ptr<Program> emulator, run;
  std::unique_ptr<test::EmulatorControlClient> control;
  std::string port_of_x;
  pid_t guard = -1;
  int runs = 0;
  std::chrono::seconds thaw_after{0};
  std::chrono::milliseconds slowest{0};
};

using Case = std::tuple<std::string, Injection>;

std::string name_of_case(const testing::TestParamInfo<Case>& info) {
  return std::get<0>(info.param) + "_" + name_of(std::get<1>(info.param));
}

class EachInjection : public HangTest, public testing::WithParamInterface<Case> {};

TEST_P(EachInjection, LeavesNothingMoving) {
  inject_and_expect_rest(std::get<0>(GetParam()), std::get<1>(GetParam()), 1);
}

INSTANTIATE_TEST_SUITE_P(Quick, EachInjection,
                         testing::Combine(testing::Values("pi_gcs"),
                                          testing::Values(Injection::kStopRun, Injection::kStopThread,
                                                          Injection::kKillGuard, Injection::kUnplugAndKill,
                                                          Injection::kFreezeBoth)),
                         name_of_case);

class LongEachInjection : public EachInjection {};

TEST_P(LongEachInjection, LeavesNothingMoving) {
  inject_and_expect_rest(std::get<0>(GetParam()), std::get<1>(GetParam()), 10);
}

std::vector<std::string> names_of_stages() {
  std::vector<std::string> names;
  for (const StageCase& stage : stages()) names.push_back(stage.name);
  return names;
}

INSTANTIATE_TEST_SUITE_P(
    EachStage, LongEachInjection,
    testing::Combine(testing::ValuesIn(names_of_stages()),
                     testing::Values(Injection::kStopRun, Injection::kStopThread, Injection::kKillRun,
                                     Injection::kKillGuard, Injection::kStopGuard, Injection::kUnplug,
                                     Injection::kUnplugAndKill, Injection::kFreezeBoth, Injection::kBabble)),
    name_of_case);

/// Stop from another program reaches the guard of a run that hangs, which confirms the rest of each axis.
TEST_F(HangTest, StopOfAnotherProgramReachesTheGuardDirectly) {
  start_emulator("pi_gcs");
  std::mt19937_64 random(20261125);
  start_in_motion(random);
  run->signal(SIGSTOP);
  const auto asked = std::chrono::steady_clock::now();
  const auto answers = ask_guards(run->pid(), {{"kind", "halt"}, {"by", "the test"}}, 500ms);
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_THAT(answers.front().at("halted").get<std::string>(), HasSubstr("the test"));
  expect_at_rest_after(asked, 500ms);
  ASSERT_TRUE(test::wait_for(
      [&] {
        const auto status = ask_guards(run->pid(), {{"kind", "status"}}, 500ms);
        return status.size() == 1 && status.front().at("axes").at("x").at("state") == "at rest";
      },
      5s));
  run->signal(SIGCONT);
  EXPECT_EQ(run->wait(), 3) << run->err();
  EXPECT_THAT(run->err(), HasSubstr("stopped by the test"));
  EXPECT_THAT(test::read_file(folder / "state/abcal/motion.log"), HasSubstr("stopped by the test"));
}

}  // namespace
}  // namespace abcal
