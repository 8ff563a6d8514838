// Effect of a signal on the program: a computation ends at once, an activity that moves a stage does not.

#include "app/system/interrupt.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <sstream>

#include "app/bench_file/bench_config.h"
#include "app/measure/bench/make_bench.h"
#include "app/system/helper_program.h"
#include "app/system/last_signal.h"
#include "drivers/instrument/instrument_error.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

/// Averaged readings of some accelerometer at this many angles of each experiment.
std::string sine_readings(int steps) {
  std::ostringstream csv;
  csv.precision(17);
  csv << "experiment,n,alpha_deg,r_u,r_v,r_w\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 0; n < steps; ++n) {
      const double alpha = 2.0 * std::numbers::pi * n / steps;
      const double sine = std::sin(alpha), cosine = std::cos(alpha);
      const double noise = 1e-4 * std::sin(1.0 * n * n + experiment);
      const double u = experiment == 1 ? 0.0 : -sine;
      const double v = experiment == 1 ? sine : experiment == 2 ? 0.0 : -cosine;
      const double w = experiment == 3 ? 0.0 : cosine;
      csv << experiment << ',' << n + 1 << ',' << 360.0 * n / steps << ',' << 1.1 * u + 0.1 + noise << ','
          << 0.9 * v - 0.2 + noise << ',' << w + 0.3 - noise << '\n';
    }
  }
  return csv.str();
}

/// Processor time of a running process.
double cpu_seconds(pid_t pid) {
  const std::string status = test::read_file("/proc/" + std::to_string(pid) + "/stat");
  std::istringstream words(status.substr(std::min(status.size(), status.rfind(')') + 1)));
  std::string word;
  for (int field = 3; field < 14; ++field) words >> word;
  double user = 0.0, system = 0.0;
  words >> user >> system;
  return (user + system) / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

/// Whether a process has ended; a zombie counts as ended.
bool has_ended(const std::string& pid) {
  const std::string status = test::read_file("/proc/" + pid + "/stat");
  return status.empty() || status.find(") Z") != std::string::npos;
}

/// Restores the default actions, so that nohup around the tests does not protect the programs they start.
void heed_signals() {
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) std::signal(number, SIG_DFL);
}

class SignalsTest : public ProgramTest {
 protected:
  SignalsTest() { heed_signals(); }
};

TEST_F(SignalsTest, EndAtOnceWhatOnlyComputes) {
  // The fits of this many angles take longer than everything else, 10 s or more.
  test::write_file(folder / "long.csv", sine_readings(2400));
  test::write_file(folder / "other.csv", sine_readings(2399));
  const std::vector<std::pair<int, std::vector<std::string>>> cases{
      {SIGINT, {"analyse", "long.csv"}},
      {SIGTERM, {"analyse", "long.csv", "--json"}},
      {SIGHUP, {"report", "long.csv", "--html", "long.html"}},
      {SIGINT, {"compare", "long.csv", "other.csv"}},
      {SIGTERM, {"export", "long.csv", "--as", "json"}}};
  for (const auto& [number, arguments] : cases) {
    test::Program program(arguments, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return cpu_seconds(program.pid()) > 0.3; }, 60s)) << program.err();
    ASSERT_TRUE(program.running()) << arguments.front() << ": " << program.out() << program.err();
    program.signal(number);
    ASSERT_TRUE(test::wait_for([&] { return !program.running(); }, 20s)) << arguments.front();
    EXPECT_EQ(program.wait(), 128 + number) << arguments.front();
    EXPECT_EQ(program.out(), "") << arguments.front();
  }
}

class SignalsAndHelpersTest : public SignalsTest {
 protected:
  SignalsAndHelpersTest() : path_(std::getenv("PATH")) {
    std::filesystem::create_directory(folder / "bin");
    std::filesystem::create_directory(folder / "tmp");
    ::setenv("PATH", ((folder / "bin").string() + ":" + path_).c_str(), 1);
    ::setenv("TMPDIR", (folder / "tmp").c_str(), 1);
  }
  ~SignalsAndHelpersTest() override {
    ::setenv("PATH", path_.c_str(), 1);
    ::unsetenv("TMPDIR");
  }

 private:
  std::string path_;
};

TEST_F(SignalsAndHelpersTest, NoHelperAndNoTemporaryFileOutlivesTheProgram) {
  const std::filesystem::path printer = folder / "bin/weasyprint", started = folder / "started";
  ASSERT_EQ(abcal({"run", (test::source_folder() / "docs/examples/simulated.toml").string(), "-o", "a.run"})
                .exit_code,
            0);
  test::write_file(printer, "#!/bin/sh\nsleep 600 &\necho $! >'" + started.string() + "'\nwait\n");
  std::filesystem::permissions(printer, std::filesystem::perms::owner_all);
  test::Program report({"report", "a.run", "--draft", "--pdf", "a.pdf", "--laboratory",
                        (test::source_folder() / "docs/examples/laboratory.toml").string()},
                       folder.path());
  ASSERT_TRUE(test::wait_for([&] { return test::read_file(started).ends_with('\n'); }, 60s)) << report.err();
  report.signal(SIGTERM);
  EXPECT_EQ(report.wait(), 128 + SIGTERM);
  std::string pid = test::read_file(started);
  pid.pop_back();
  EXPECT_TRUE(test::wait_for([&] { return has_ended(pid); }, 10s)) << "what the helper had started";
  EXPECT_TRUE(std::filesystem::is_empty(folder / "tmp"));
  for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
    EXPECT_NE(entry.path().extension(), ".pdf") << entry.path();
}

/// Sends this process a signal, and waits until it has been handled. @return 7 if the process goes on
int seen_through(int number) {
  ::kill(::getpid(), number);
  while (last_interrupt_signal() == 0) ::usleep(1000);
  return 7;
}

TEST(SignalPolicyDeathTest, ASignalEndsByItsDefaultActionUntilAnOrderlyEndIsUndertaken) {
  const auto unheeded = [] {
    heed_signals();
    watch_for_signals();
    std::_Exit(seen_through(SIGTERM));
  };
  EXPECT_EXIT(unheeded(), testing::KilledBySignal(SIGTERM), "");
  const auto undertaken = [] {
    heed_signals();
    watch_for_signals();
    const std::stop_token token = interrupt_token();
    const int code = seen_through(SIGTERM);
    while (!token.stop_requested()) ::usleep(1000);
    std::_Exit(code);
  };
  EXPECT_EXIT(undertaken(), testing::ExitedWithCode(7), "");
}

TEST(SignalPolicyDeathTest, WhatIsToBeDoneFirstIsDone) {
  const auto say = [](const char* text) { (void)!::write(STDERR_FILENO, text, 4); };
  const auto end = [&] {
    heed_signals();
    watch_for_signals();
    const BeforeSignalEnds first([&] { say("one "); });
    {
      const BeforeSignalEnds gone([&] { say("not "); });
    }
    const BeforeSignalEnds second([&] { say("two "); });
    std::_Exit(seen_through(SIGINT));
  };
  EXPECT_EXIT(end(), testing::KilledBySignal(SIGINT), "^one two $");
}

TEST(SignalPolicyDeathTest, AnIgnoredSignalStaysIgnored) {
  const auto end = [] {
    heed_signals();
    std::signal(SIGHUP, SIG_IGN);  // nohup
    watch_for_signals();
    ::kill(::getpid(), SIGHUP);  // The first of two pending signals, as it has the lowest number.
    std::_Exit(seen_through(SIGTERM));
  };
  EXPECT_EXIT(end(), testing::KilledBySignal(SIGTERM), "");
}

// Any command that opens a real stage is protected: a signal does not end it without a halt of the stage.
TEST(SignalPolicyDeathTest, WhoeverOpensAStageHasUndertakenAnOrderlyEnd) {
  const auto open = [](const std::string& port) {
    heed_signals();
    watch_for_signals();
    set_helper_folder(
        std::filesystem::path(test::abcal_program()).parent_path());  // The guard opens the port.
    BenchText bench;
    bench.stage_port = port;
    try {
      (void)make_bench(parse_bench(bench.text(), "bench.toml"));
    } catch (const InstrumentError&) {  // There is no such stage.
    }
    std::_Exit(seen_through(SIGTERM));
  };
  EXPECT_EXIT(open("/nowhere/stage"), testing::ExitedWithCode(7), "");
  EXPECT_EXIT(open("simulated"), testing::KilledBySignal(SIGTERM), "");
}

}  // namespace
}  // namespace abcal
