// A program that moves a stage hangs or dies, its guard dies, or the port is gone for a while: the stage is
// at rest within 1.25 s of the fault or of the port's return. The emulator, a process of its own, knows the
// motion of the stage. ABCAL_FAULT_PAIRS is the number of random pairs of faults that the long test draws
// (default 40).

#include <dirent.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/ptrace.h>

#include <algorithm>
#include <atomic>
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

#include "app/console/bench_service.h"
#include "app/console/guard_watch.h"
#include "app/measure/guard/halt_guard.h"
#include "drivers/text/names.h"
#include "protocol/record/run_file.h"
#include "tests/app/guard_faults.h"
#include "tests/app/instrument_cases.h"
#include "tests/app/program_fixtures.h"
#include "tests/console/client.h"
#include "tests/support/emulator_control.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::Program;
using testing::HasSubstr;
using testing::Not;
using Json = test::PageClient::Json;
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
  kUnplug,              ///< The port is gone for 2 s, in motion.
  kUnplugAndKill,       ///< The port is gone for 2 s, and the program is killed meanwhile.
  kUnplugAndEnd,        ///< The port is gone for 2 s; SIGTERM after 0.5 s, then Ctrl-C.
  kUnplugAndKillGuard,  ///< The port is gone for 2 s, and the guard is killed meanwhile.
  kSuspend,             ///< Ctrl-Z.
  kFreezeBoth,          ///< Program and guard stand still for 2 s, as in a frozen container.
  kBabble,              ///< Killed, and the controller answers with lines of 64 kB for half a second.
  kLongBabble,          ///< The same with lines of 1 MB.
  kKillBoth,            ///< Program and guard are killed at once: nothing halts (docs/halting.md).
  kSecondRun,           ///< Another run on the same bench begins.
  kStopBench,           ///< SIGSTOP of the process that holds the bench of a console.
};

constexpr auto kInjections = names<Injection>({{Injection::kStopRun, "stop_run"},
                                               {Injection::kStopThread, "stop_thread"},
                                               {Injection::kKillRun, "kill_run"},
                                               {Injection::kKillGuard, "kill_guard"},
                                               {Injection::kStopGuard, "stop_guard"},
                                               {Injection::kUnplug, "unplug"},
                                               {Injection::kUnplugAndKill, "unplug_and_kill"},
                                               {Injection::kUnplugAndEnd, "unplug_and_end"},
                                               {Injection::kUnplugAndKillGuard, "unplug_and_kill_guard"},
                                               {Injection::kSuspend, "suspend"},
                                               {Injection::kFreezeBoth, "freeze_both"},
                                               {Injection::kBabble, "babble"},
                                               {Injection::kLongBabble, "long_babble"},
                                               {Injection::kKillBoth, "kill_both"},
                                               {Injection::kSecondRun, "second_run"},
                                               {Injection::kStopBench, "stop_bench"}});

std::string name_of(Injection injection) {
  return std::string(kInjections.of(injection));
}

/// Whether the run may go on by itself when the port is back.
bool may_go_on(Injection injection) {
  return injection == Injection::kUnplug || injection == Injection::kUnplugAndKillGuard;
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

  void start_emulator(const std::string& stage, bool sweeps = false) {
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
      bench = replaced(bench, "[bench]\n", "[bench]\nname = \"hang\"\n");
      if (sweeps) {
        bench = replaced(bench, "[protocol]\n",
                         "[protocol]\nmotion = \"constant_rate\"\nrate_deg_per_s = [5, 3]\n"
                         "acceleration_deg_per_s2 = 1000.0\n");
      }
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
    is_sweeping = sweeps;
  }

  std::size_t measured(const std::filesystem::path& file) {
    try {
      return std::filesystem::exists(file) ? RunFile::load(file).measured.size() : 0;
    } catch (const RunFileError&) {  // Not written yet.
      return 0;
    }
  }

  /// Whether X turns through its first circle, which begins below 0 degrees and takes 72 s. Homing turns it
  /// down to 0, from wherever it stands.
  bool is_in_sweep() {
    const auto angle_deg = [&] {
      const Json x = control->ask({{"do", "status"}}).at("x");
      return x.at("moving").get<bool>() ? x.at("actual_deg").get<double>() : 0.0;
    };
    const double before_deg = angle_deg();
    std::this_thread::sleep_for(100ms);
    return before_deg > 5.0 && angle_deg() > before_deg;
  }

  /// Starts a run and waits until the stage turns by the step of the plan (6 s) or through a circle, and a
  /// random time longer.
  void start_in_motion(std::mt19937_64& random) {
    const std::string file = fmt::format("run-{}.run", ++runs);
    run = std::make_unique<Program>(std::vector<std::string>{"run", "bench.toml", "-o", file}, folder.path());
    if (is_sweeping) {
      ASSERT_TRUE(test::wait_for([&] { return is_in_sweep() || !run->running(); }, 60s));
    } else {
      ASSERT_TRUE(test::wait_for([&] { return measured(folder / file) > 0 || !run->running(); }, 60s));
      ASSERT_TRUE(test::wait_for([&] { return control->anything_moves() || !run->running(); }, 20s));
    }
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
      case Injection::kUnplugAndEnd:
        unplug();
        from += 2s;
        std::this_thread::sleep_for(500ms);
        run->signal(SIGTERM);
        std::this_thread::sleep_for(1200ms);
        run->signal(SIGINT);
        break;
      case Injection::kUnplugAndKillGuard:
        unplug();
        ::kill(guard, SIGKILL);
        from += 2s;
        break;
      case Injection::kSuspend:
        run->signal(SIGTSTP);
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
      case Injection::kLongBabble:
        control->ask({{"do", "fault"},
                      {"kind", "replaced-reply"},
                      {"instrument", port_of_x},
                      {"text", std::string(injection == Injection::kBabble ? 65'536 : 1'048'576, 'x')},
                      {"for_s", 0.5}});
        run->signal(SIGKILL);
        break;
      case Injection::kKillBoth:
      case Injection::kSecondRun:
      case Injection::kStopBench:
        ADD_FAILURE() << "has a test of its own";
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

  /// Nothing halts; the axes end their moves. The next run says how the one before ended.
  void kill_both(int times) {
    std::mt19937_64 random(20261126);
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      start_in_motion(random);
      if (HasFatalFailure()) return;
      run->signal(SIGSTOP);  // Neither may see the other die.
      ::kill(guard, SIGKILL);
      run->signal(SIGKILL);
      run->wait();
      EXPECT_TRUE(test::wait_for([&] { return !control->anything_moves(); }, 20s)) << "one step of the plan";
      start_in_motion(random);
      if (HasFatalFailure()) return;
      const std::vector<RunEvent> events = RunFile::load(folder / fmt::format("run-{}.run", runs)).events;
      EXPECT_TRUE(std::ranges::any_of(events,
                                      [](const RunEvent& e) {
                                        return e.text.english().find("did not end in order") !=
                                               std::string::npos;
                                      }))
          << "the run says nothing of the session before\n"
          << test::read_file(folder / "state/abcal/motion.log");
      run->signal(SIGINT);
      run->wait();
    }
  }

  /// The second run is refused with the words of the first one, which goes on.
  void start_second_run(int times) {
    std::mt19937_64 random(20261127);
    start_in_motion(random);
    if (HasFatalFailure()) return;
    const std::filesystem::path first = folder / "run-1.run";
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      ASSERT_TRUE(test::wait_for([&] { return control->anything_moves(); }, 20s));
      Program second({"run", "bench.toml", "-o", "second.run"}, folder.path());
      EXPECT_NE(second.wait(), 0);
      EXPECT_THAT(second.err(), HasSubstr(fmt::format("(process {}", run->pid())));
      EXPECT_FALSE(std::filesystem::exists(folder / "second.run"));
      const std::size_t before = measured(first);
      EXPECT_TRUE(test::wait_for([&] { return measured(first) > before; }, 20s)) << "the first run goes on";
    }
    EXPECT_TRUE(run->running());
    run->signal(SIGINT);
    EXPECT_EQ(run->wait(), 130) << run->err();
  }

  /// A console and a page that steers it.
  void start_console() {
    std::filesystem::create_directories(folder / "runs");
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
    page = std::make_unique<test::PageClient>(static_cast<std::uint16_t>(std::stoi(found[1])));
    page->wait_for_type("snapshot");
    ASSERT_TRUE(page->ok({{"do", "control"}}));
  }

  /// Whether the page says "Idle", or its Stop is grey, by the messages so far: as page/stop.js decides it.
  bool page_says_idle() {
    while (const std::optional<Json> message = page->next(std::chrono::steady_clock::now())) {
      const Json& m = *message;
      if (m["type"] == "snapshot") {
        activity = m["activity"]["activity"];
        if (m.contains("bench")) bench_state = m["bench"]["state"];
      } else if (m["type"] == "activity") {
        activity = m["activity"];
      } else if (m["type"] == "bench") {
        bench_state = m["state"];
      } else if (m["type"] == "guard") {
        axes = m["axes"];
      } else if (m["type"] == "dwell_done") {
        ++dwells;
      }
    }
    const auto rests = [&](const char* axis) {
      const std::string state = state_of(axis);
      return state == "at rest" || state == "not moved";
    };
    return activity == "idle" && bench_state == "on" && rests("x") && rests("z");
  }

  /// State of an axis by the latest message to the page.
  std::string state_of(const char* axis) const {
    return axes.contains(axis) ? axes[axis]["state"].get<std::string>() : "unknown";
  }

  /// A jog of X, which takes half a minute.
  void start_jog() {
    start_console();
    if (HasFatalFailure()) return;
    ASSERT_TRUE(page->ok({{"do", "jog"}, {"axis", "x"}, {"by_deg", 150}, {"confirmed", true}}));
    ASSERT_TRUE(test::wait_for(
        [&] {
          return control->ask({{"do", "status"}}).at("x").at("actual_deg").get<double>() > 10.0;
        },
        60s));
    ASSERT_TRUE(control->anything_moves());
    holder = std::stoi(test::read_file(bench_lock()));
    guard = guard_of(holder);
    ASSERT_GT(guard, 0);
  }
  std::string bench_lock() const {
    return console::default_bench_socket({"bench.toml", folder / "runs", 1.0}).string() + ".lock";
  }
  void end_console() {
    server->signal(SIGINT);
    server->wait();
  }

  void stop_bench(int times) {
    start_console();
    if (HasFatalFailure()) return;
    std::mt19937_64 random(20261128);
    std::string file;
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      const Json reply = page->ask(k == 0 ? Json{{"do", "start"}, {"confirmed", true}}
                                          : Json{{"do", "resume"}, {"run", file}, {"confirmed", true}});
      ASSERT_TRUE(reply["ok"].get<bool>()) << reply;
      const int before = dwells;  // The step to the next angle takes 6 s.
      ASSERT_TRUE(test::wait_for([&] { return !page_says_idle() && dwells > before; }, 150s));
      const auto delay = std::chrono::milliseconds(300 + random() % 500);
      ASSERT_TRUE(test::wait_for(
          [&] {  // Short moves, to the approach of an angle, do not last for it.
            if (!control->anything_moves()) return false;
            std::this_thread::sleep_for(delay);
            return control->anything_moves();
          },
          60s));
      page_says_idle();
      holder = std::stoi(test::read_file(bench_lock()));
      ::kill(holder, SIGSTOP);
      const auto from = std::chrono::steady_clock::now();
      bool was_idle = false;
      while (std::chrono::steady_clock::now() < from + kLimit + kDeceleration) {
        if (control->anything_moves()) {
          was_idle = was_idle || page_says_idle();
          slowest = std::max(slowest, std::chrono::duration_cast<std::chrono::milliseconds>(
                                          std::chrono::steady_clock::now() - from));
        }
        std::this_thread::sleep_for(5ms);
      }
      EXPECT_FALSE(was_idle) << "idle, or a grey Stop, in motion";
      EXPECT_FALSE(control->anything_moves());
      ::kill(holder, SIGCONT);
      ASSERT_TRUE(test::wait_for([&] { return page_says_idle(); }, 60s)) << activity << bench_state << axes;
      EXPECT_FALSE(control->anything_moves());
      for (const auto& entry : std::filesystem::directory_iterator(folder / "runs"))
        if (entry.path().extension() == ".run") file = entry.path().filename();
    }
    end_console();
  }

  void end_run(Injection injection) {
    std::this_thread::sleep_for(std::exchange(thaw_after, 0s));
    if (injection == Injection::kStopThread) ::ptrace(PTRACE_DETACH, run->pid(), nullptr, nullptr);
    run->signal(SIGCONT);
    if (injection == Injection::kUnplugAndEnd) {
      run->wait();
      EXPECT_THAT(run->err(),
                  HasSubstr(fmt::format("waits until abcal-guard (process {}) has halted it", guard)));
      EXPECT_THAT(run->err(), HasSubstr("axis X: did not acknowledge the halt, may be moving since"));
      EXPECT_THAT(run->err(), HasSubstr("all axes are at rest"));
      return;
    }
    if (may_go_on(injection)) {
      run->signal(SIGINT);
      run->wait();
      return;
    }
    const int code = run->wait();
    if (injection == Injection::kStopRun || injection == Injection::kStopThread ||
        injection == Injection::kKillGuard || injection == Injection::kStopGuard ||
        injection == Injection::kSuspend || injection == Injection::kFreezeBoth) {
      EXPECT_EQ(code, 3) << run->err();
      EXPECT_THAT(run->err(), HasSubstr("guard")) << "the reason";
      EXPECT_THAT(run->err(), HasSubstr("resume"));
      if (injection == Injection::kSuspend) {
        EXPECT_THAT(run->err(), HasSubstr("Ctrl-Z"));
      }
      EXPECT_THAT(run->err(), Not(HasSubstr("may be moving"))) << "the guard has confirmed the rest";
      EXPECT_THAT(run->err(), Not(HasSubstr("the watchdog halted"))) << "the guard was the first";
    }
    if (injection == Injection::kStopGuard) ::kill(guard, SIGKILL);
  }

  void inject_and_expect_rest(const std::string& stage, Injection injection, int times,
                              bool in_sweep = false) {
    start_emulator(stage, in_sweep);
    if (HasFatalFailure()) return;
    if (injection == Injection::kKillBoth) return kill_both(times);
    if (injection == Injection::kSecondRun) return start_second_run(times);
    if (injection == Injection::kStopBench) {
      stop_bench(times);
      fmt::print("{} {}: {} times, at rest after {} ms at the latest\n", stage, name_of(injection), times,
                 slowest.count());
      return;
    }
    std::mt19937_64 random(20261125 + static_cast<unsigned>(injection));
    for (int k = 0; k < times; ++k) {
      SCOPED_TRACE(k);
      start_in_motion(random);
      if (HasFatalFailure()) return;
      const SteadyTime from = inject(injection);
      if (HasFailure()) return;
      // Longer than the patience of the watchdog: the reason is the guard's halt nevertheless.
      if (injection == Injection::kStopRun && k == 0) thaw_after = 6s;
      const bool babbles = injection == Injection::kBabble || injection == Injection::kLongBabble;
      const auto babble = babbles ? 500ms : 0ms;
      if (may_go_on(injection)) {  // But only once the axes were at rest.
        std::this_thread::sleep_until(from);
        EXPECT_TRUE(test::wait_for([&] { return !control->anything_moves(); }, kLimit + kDeceleration));
        end_run(injection);
        continue;
      }
      // Before Ctrl-Z suspends the program, not a second after the last beat.
      const auto limit = injection == Injection::kSuspend ? 500ms : kLimit;
      expect_at_rest_after(from, limit + kDeceleration + babble);
      if (HasFailure()) run->signal(SIGINT);  // A run that was not halted would go on to its end.
      end_run(injection);
      // The next run finds the ports free.
      ASSERT_TRUE(test::wait_for([&] { return ::kill(guard, 0) != 0 || guard_of(run->pid()) < 0; }, 20s));
    }
    if (HasFailure()) fmt::print("{}", test::read_file(folder / "state/abcal/motion.log"));
    fmt::print("{} {}: {} times, at rest after {} ms at the latest\n", stage, name_of(injection), times,
               slowest.count());
  }

  std::unique_ptr<Program> emulator, run, server;
  std::unique_ptr<test::EmulatorControlClient> control;
  std::unique_ptr<test::PageClient> page;
  std::string activity = "idle", bench_state = "on";  ///< As the messages to the page say.
  Json axes = Json::object();
  int dwells = 0;
  std::string port_of_x;
  bool is_sweeping = false;
  pid_t guard = -1, holder = -1;
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
                                                          Injection::kUnplugAndKillGuard, Injection::kSuspend,
                                                          Injection::kFreezeBoth)),
                         name_of_case);
INSTANTIATE_TEST_SUITE_P(QuickEnd, EachInjection,
                         testing::Combine(testing::Values("pi_gcs", "zaber_ascii", "newport_xps"),
                                          testing::Values(Injection::kUnplugAndEnd)),
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
                                     Injection::kUnplugAndKill, Injection::kUnplugAndEnd,
                                     Injection::kUnplugAndKillGuard, Injection::kSuspend,
                                     Injection::kFreezeBoth, Injection::kBabble, Injection::kLongBabble,
                                     Injection::kKillBoth, Injection::kSecondRun, Injection::kStopBench)),
    name_of_case);

/// The same while an axis turns through a circle at a constant rate.
class InSweep : public EachInjection {};

TEST_P(InSweep, LeavesNothingMoving) {
  inject_and_expect_rest(std::get<0>(GetParam()), std::get<1>(GetParam()), 1, true);
}

INSTANTIATE_TEST_SUITE_P(Quick, InSweep,
                         testing::Combine(testing::Values("pi_gcs"),
                                          testing::Values(Injection::kKillRun, Injection::kKillGuard)),
                         name_of_case);

class LongInSweep : public EachInjection {};

TEST_P(LongInSweep, LeavesNothingMoving) {
  inject_and_expect_rest(std::get<0>(GetParam()), std::get<1>(GetParam()), 2, true);
}

INSTANTIATE_TEST_SUITE_P(EachStage, LongInSweep,
                         testing::Combine(testing::ValuesIn(names_of_stages()),
                                          testing::Values(Injection::kStopRun, Injection::kKillRun,
                                                          Injection::kKillGuard, Injection::kUnplug,
                                                          Injection::kUnplugAndEnd, Injection::kFreezeBoth)),
                         name_of_case);

enum class Phase { kMove, kSweep, kHoming, kCheck, kLevel, kJog };

constexpr auto kPhases = names<Phase>({{Phase::kMove, "move"},
                                       {Phase::kSweep, "sweep"},
                                       {Phase::kHoming, "homing"},
                                       {Phase::kCheck, "check"},
                                       {Phase::kLevel, "level"},
                                       {Phase::kJog, "jog"}});

bool is_of_guard(FaultKind fault) {
  return fault == FaultKind::kKillGuard || fault == FaultKind::kFreezeGuard;
}

/// Time from a fault until the other process has answered it with a halt (docs/halting.md), with a quarter of
/// a second for a machine that is busy; none: it ends in order or is no fault of a process.
std::chrono::milliseconds time_to_answer(FaultKind fault) {
  switch (fault) {
    case FaultKind::kKillProgram:
    case FaultKind::kKillGuard:
      return 350ms;
    case FaultKind::kFreezeProgram:
    case FaultKind::kFreezeGuard:
      return 1500ms;
    case FaultKind::kEndProgram:
    case FaultKind::kSuspendProgram:
    case FaultKind::kUnplug:
      return 0ms;
  }
  return 0ms;
}

/// Whether program and guard fail both before either has answered the other's fault: nobody need halt.
bool is_named_loss(FaultKind first, FaultKind second, std::chrono::milliseconds between) {
  const std::string pair = fmt::format("{}, {}", kFaults.of(first), kFaults.of(second));
  return named_losses().contains(pair) && between < time_to_answer(first);
}

/// Whether the program may go on by itself once it was at rest.
bool may_go_on(FaultKind first, FaultKind second) {
  const auto leaves_program = [](FaultKind fault) {
    return is_of_guard(fault) || fault == FaultKind::kUnplug;
  };
  return leaves_program(first) && leaves_program(second);
}

/// Two faults that follow one another while an axis moves. The stage is at rest within the limit of the later
/// one or of the port's return, and nobody says that an axis is at rest while it moves.
class FaultPairs : public HangTest {
 protected:
  void draw_and_expect_rest(unsigned seed) {
    std::mt19937_64 random(seed);
    const auto one_of = [&](const auto& rows) { return rows[random() % rows.size()].value; };
    const Phase phase = one_of(kPhases.rows);
    const FaultKind first = one_of(kFaults.rows), second = one_of(kFaults.rows);
    const std::chrono::milliseconds between(random() % 1500);
    const std::vector<StageCase>& all = stages();
    const std::string stage = all[random() % all.size()].name;
    const std::string words = fmt::format("{}: {}, {}: {}, {} ms later {}", seed, stage, kPhases.of(phase),
                                          kFaults.of(first), between.count(), kFaults.of(second));
    SCOPED_TRACE(words);
    start_emulator(stage, phase == Phase::kSweep);
    if (HasFatalFailure()) return;
    begin_motion(phase, random);
    if (HasFatalFailure()) return;
    watch();

    auto from = inject_fault(first);
    observe_until(std::chrono::steady_clock::now() + between);
    from = std::max(from, inject_fault(second));
    const auto limit = from + kLimit + kDeceleration;
    rested_since.reset();
    observe_until(limit);
    if (is_named_loss(first, second, between)) {
      // Whether it moves or not, nobody says what is not so.
    } else if (may_go_on(first, second)) {
      EXPECT_TRUE(rested_since) << "was never at rest";
    } else {
      EXPECT_FALSE(control->anything_moves()) << "moves after the limit";
      observe_until(limit + 300ms);
      EXPECT_FALSE(control->anything_moves()) << "moves again";
    }
    EXPECT_LE(falsely_at_rest, 1s) << "an axis is said to be at rest while it moves";
    if (HasFailure())
      fmt::print("{}\n{}{}\n{}", words, run ? run->out() : "", run ? run->err() : "",
                 test::read_file(folder / "state/abcal/motion.log"));
    release();
  }

 private:
  /// Starts the program of the phase and waits until the stage moves in it, and a random time longer.
  void begin_motion(Phase phase, std::mt19937_64& random) {
    if (phase == Phase::kMove || phase == Phase::kSweep) {
      start_in_motion(random);
      program = run ? run->pid() : -1;
      return;
    }
    if (phase == Phase::kJog) {
      start_jog();
      program = holder;
      return;
    }
    std::vector<std::string> command{"run", "bench.toml", "-o", "run-1.run"};
    if (phase == Phase::kCheck) command = {"check", "bench.toml"};
    if (phase == Phase::kLevel) command = {"level", "bench.toml"};
    run = std::make_unique<Program>(command, folder.path());
    // From the homing on, a move of 5 degrees/s lasts for seconds.
    const auto delay = std::chrono::milliseconds(300 + random() % 500);
    ASSERT_TRUE(test::wait_for(
        [&] {
          if (!run->running()) return true;
          if (!control->anything_moves()) return false;
          std::this_thread::sleep_for(delay);
          return control->anything_moves();
        },
        60s));
    ASSERT_TRUE(run->running()) << run->err() << run->out();
    program = run->pid();
    guard = guard_of(program);
    ASSERT_GT(guard, 0) << "no guard; " << run->err();
  }

  /// @return the time from which the limit counts: of the fault, or of the return of the port
  SteadyTime inject_fault(FaultKind fault) {
    const auto now = std::chrono::steady_clock::now();
    switch (fault) {
      case FaultKind::kKillProgram:
        ::kill(program, SIGKILL);
        break;
      case FaultKind::kFreezeProgram:
        ::kill(program, SIGSTOP);
        break;
      case FaultKind::kEndProgram:
        ::kill(program, SIGTERM);
        break;
      case FaultKind::kSuspendProgram:
        ::kill(program, SIGTSTP);
        break;
      case FaultKind::kKillGuard:
      case FaultKind::kFreezeGuard: {  // The one that serves now: it may have been replaced.
        const pid_t serving = guard_of(program);
        ::kill(serving > 0 ? serving : guard, fault == FaultKind::kKillGuard ? SIGKILL : SIGSTOP);
        break;
      }
      case FaultKind::kUnplug:
        control->ask({{"do", "fault"}, {"kind", "unplug"}, {"instrument", port_of_x}, {"for_s", 2.0}});
        return now + 2s;
    }
    return now;
  }

  /// Watches what is said of the axes as the console does: by the guards of the program, else by their log.
  void watch() {
    test::write_file(folder / "holder", std::to_string(program));
    watcher = std::make_unique<console::GuardWatch>(
        folder / "holder", [] { return std::string("on the bench \"hang\""); },
        [this](const console::GuardWatch::Known& known) { said_at_rest = known.is_at_rest; });
  }

  /// Notes when the axes come to rest, and for how long it is said that they are while one moves.
  void observe_until(SteadyTime end) {
    while (std::chrono::steady_clock::now() < end) {
      const auto now = std::chrono::steady_clock::now();
      const bool moves = control->anything_moves();
      if (!moves && !rested_since) rested_since = now;
      if (!moves || !said_at_rest) false_since = now;
      falsely_at_rest =
          std::max(falsely_at_rest, std::chrono::duration_cast<std::chrono::milliseconds>(now - false_since));
      std::this_thread::sleep_for(10ms);
    }
  }

  /// Ends all processes of the pair.
  void release() {
    watcher.reset();
    for (const pid_t one : {guard, guard_of(program), program}) {
      if (one <= 0) continue;
      ::kill(one, SIGCONT);
      ::kill(one, SIGKILL);
    }
    if (run) run->wait();
    if (server) end_console();
  }

  pid_t program = -1;  ///< It moves the stage: the run, or the process that holds the bench of a console.
  std::unique_ptr<console::GuardWatch> watcher;
  std::atomic<bool> said_at_rest = false;
  std::optional<SteadyTime> rested_since;
  SteadyTime false_since = std::chrono::steady_clock::now();
  std::chrono::milliseconds falsely_at_rest{0};
};

/// @return ABCAL_FAULT_PAIRS, or 40
unsigned number_of_pairs() {
  const char* stated = std::getenv("ABCAL_FAULT_PAIRS");
  return stated ? static_cast<unsigned>(std::atoi(stated)) : 40;
}

class LongFaultPairs : public FaultPairs, public testing::WithParamInterface<unsigned> {};

TEST_P(LongFaultPairs, LeaveNothingMovingButWhatTheDocumentationNames) {
  draw_and_expect_rest(GetParam());
}

INSTANTIATE_TEST_SUITE_P(Drawn, LongFaultPairs, testing::Range(1U, 1U + number_of_pairs()));

TEST_F(FaultPairs, ADrawnPairLeavesNothingMoving) {
  draw_and_expect_rest(20261130);
}

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

/// The page says it, too, and Stop can be pressed.
TEST_F(HangTest, AJogWhosePortIsGoneIsHaltedAtItsReturnAndNotIdleBefore) {
  start_emulator("pi_gcs");
  start_jog();
  if (HasFatalFailure()) return;
  page_says_idle();
  control->ask({{"do", "fault"}, {"kind", "unplug"}, {"instrument", port_of_x}, {"for_s", 2.0}});
  const auto from = std::chrono::steady_clock::now() + 2s;
  bool was_idle = false;
  while (std::chrono::steady_clock::now() < from + kLimit + kDeceleration) {
    if (control->anything_moves()) was_idle = was_idle || page_says_idle();
    std::this_thread::sleep_for(5ms);
  }
  EXPECT_FALSE(was_idle) << "idle, or a grey Stop, in motion";
  EXPECT_FALSE(control->anything_moves());
  EXPECT_TRUE(test::wait_for([&] { return page_says_idle(); }, 20s)) << activity << bench_state << axes;
  end_console();
}

/// Nobody is left who could halt it or see it stop: nobody says that it is at rest, and no Stop is called
/// done.
TEST_F(HangTest, AJogWhoseProgramAndGuardAreKilledIsNotKnownToBeAtRest) {
  start_emulator("pi_gcs");
  start_jog();
  if (HasFatalFailure()) return;
  ::kill(holder, SIGSTOP);  // Neither may see the other die.
  ::kill(guard, SIGKILL);
  ::kill(holder, SIGKILL);
  EXPECT_TRUE(test::wait_for(
      [&] {
        EXPECT_FALSE(page_says_idle());
        return state_of("x") == "unknown";
      },
      10s))
      << axes;
  EXPECT_TRUE(control->anything_moves());
  const auto is_replaced = [&] {
    EXPECT_FALSE(page_says_idle());
    const int now = std::atoi(test::read_file(bench_lock()).c_str());
    return now > 0 && now != holder && bench_state == "on";
  };
  ASSERT_TRUE(test::wait_for(is_replaced, 20s)) << "another process holds the bench now";
  const Json reply = page->ask({{"do", "stop"}});
  EXPECT_FALSE(reply["ok"].get<bool>());
  EXPECT_THAT(reply["why"].get<std::string>(), HasSubstr("no guard answers"));
  EXPECT_FALSE(page_says_idle());
  end_console();
}

}  // namespace
}  // namespace abcal
