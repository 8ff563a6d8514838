// Other programs: their state at the start, and that they leave nothing behind.

#include "app/system/child_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <string>

#include "app/document/gnuplot.h"
#include "protocol/run/experiment_run.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

const Tool kShell{"sh", "the test needs", "dash"};

/// Whether a process has ended; a zombie counts as ended.
bool has_ended(const std::string& pid) {
  const std::string status = test::read_file("/proc/" + pid + "/stat");
  return status.empty() || status.find(") Z") != std::string::npos;
}

std::string first_line(const std::filesystem::path& file) {
  const std::string text = test::read_file(file);
  return text.ends_with('\n') ? text.substr(0, text.find('\n')) : std::string();
}

class ChildProcessTest : public testing::Test {
 protected:
  test::TemporaryFolder folder;
};

TEST_F(ChildProcessTest, ItsWordsAndItsExitCodeComeBack) {
  const ToolResult result = run_tool_for_words(kShell, {"-c", "echo out; echo err >&2; exit 3"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_EQ(result.words, "out\nerr");
  EXPECT_EQ(run_tool_for_words(kShell, {"-c", "kill -9 $$"}).exit_code, 128 + SIGKILL);
  // More than a pipe holds, and more than is kept.
  EXPECT_EQ(run_tool_for_words(kShell, {"-c", "head -c 300000 /dev/zero | tr '\\0' x"}).words.size(),
            65'536U);
}

TEST_F(ChildProcessTest, IsAGroupOfItsOwnWithoutOurDescriptors) {
  const int open_here = ::dup(STDERR_FILENO);  // Without FD_CLOEXEC.
  const ToolResult result =
      run_tool_for_words(kShell, {"-c", "cut -d' ' -f1,5 /proc/$$/stat; test -e /proc/$$/fd/" +
                                            std::to_string(open_here) + " || echo closed"});
  ::close(open_here);
  const std::string line = result.words.substr(0, result.words.find('\n'));
  EXPECT_EQ(line.substr(0, line.find(' ')), line.substr(line.find(' ') + 1)) << "process and its group";
  EXPECT_THAT(result.words, testing::EndsWith("\nclosed"));
}

TEST_F(ChildProcessTest, WhatItStartedEndsWithIt) {
  const auto file = folder / "pid";
  EXPECT_EQ(run_tool(kShell, {"-c", "sleep 600 & echo $! > '" + file.string() + "'"}), 0);
  const std::string pid = first_line(file);
  ASSERT_FALSE(pid.empty());
  EXPECT_TRUE(test::wait_for([&] { return has_ended(pid); }, 10s));
}

TEST_F(ChildProcessTest, TakesNoLongerThanItMay) {
  const auto start = std::chrono::steady_clock::now();
  try {
    run_tool(kShell, {"-c", "sleep 600"}, ToolOutput::kHidden, 0s);
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("sh took longer than 0 s"));
  }
  EXPECT_LT(std::chrono::steady_clock::now() - start, 60s);
}

// WeasyPrint loads while the page is made.
TEST_F(ChildProcessTest, IsStartedBeforeItsInputIsKnown) {
  const auto file = folder / "pid";
  ToolAwaitingInput counter(kShell, {"-c", "echo $$ > '" + file.string() + "'; wc -c; exit 3"});
  ASSERT_TRUE(test::wait_for([&] { return !first_line(file).empty(); }, 30s)) << "not at work yet";
  // More than a socket holds.
  const ToolResult result = counter.finish(std::string(3'000'000, 'x'));
  EXPECT_EQ(result.words, "3000000");
  EXPECT_EQ(result.exit_code, 3);
}

TEST_F(ChildProcessTest, MayEndWithoutReadingItsInput) {
  ToolAwaitingInput deaf(kShell, {"-c", "echo no; exit 4"});
  const ToolResult result = deaf.finish(std::string(3'000'000, 'x'));
  EXPECT_EQ(result.words, "no");
  EXPECT_EQ(result.exit_code, 4);
}

TEST_F(ChildProcessTest, IsEndedWhereNoInputCame) {
  const auto file = folder / "pid";
  {
    const ToolAwaitingInput waiting(kShell, {"-c", "echo $$ > '" + file.string() + "'; cat"});
    ASSERT_TRUE(test::wait_for([&] { return !first_line(file).empty(); }, 30s));
  }
  EXPECT_TRUE(has_ended(first_line(file)));
  ToolAwaitingInput cancelled(kShell, {"-c", "cat; sleep 600"});
  EXPECT_THROW(cancelled.finish("x", kLongestTool, [] { return true; }), RunInterrupted);
}

TEST_F(ChildProcessTest, EndsWhereWeAreKilled) {
  const auto file = folder / "pid";
  const pid_t ours = ::fork();
  ASSERT_GE(ours, 0);
  if (ours == 0) {
    run_tool(kShell, {"-c", "echo $$ > '" + file.string() + "'; exec sleep 600"});
    ::_exit(0);
  }
  ASSERT_TRUE(test::wait_for([&] { return !first_line(file).empty(); }, 30s));
  ::kill(ours, SIGKILL);
  int status = 0;
  ::waitpid(ours, &status, 0);
  EXPECT_TRUE(test::wait_for([&] { return has_ended(first_line(file)); }, 10s));
}

// ~/.gnuplot is a program: a report must not run it.
TEST_F(ChildProcessTest, GnuplotReadsNoStartUpFile) {
  if (!is_installed(kGnuplot)) GTEST_SKIP() << "gnuplot is not installed";
  test::write_file(folder / ".gnuplot", "system 'touch " + (folder / "run").string() + "'\n");
  const char* home = std::getenv("HOME");
  const std::string before = home != nullptr ? home : "";
  ::setenv("HOME", folder.path().c_str(), 1);
  EXPECT_THAT(draw_svg("plot x", 300), HasSubstr("<svg"));
  ::setenv("HOME", before.c_str(), 1);
  EXPECT_FALSE(std::filesystem::exists(folder / "run"));
}

}  // namespace
}  // namespace abcal
