// A disk that fails under SQLite at any one of the calls of a whole run, once or for good: the run completes,
// or it ends with the reason and the stage at rest. The file can be read afterwards, contains every angle
// that was reported as measured, and the resumed run gives the same bits as an undisturbed one.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "app/results/analysis/estimators.h"
#include "app/results/analysis/result_json.h"
#include "protocol/record/verify_run.h"
#include "tests/app/in_process_run.h"
#include "tests/app/repeatable_run.h"
#include "tests/support/failing_disk.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using test::FailingDisk;
using test::InProcessRun;
using testing::AnyOf;
using testing::HasSubstr;
using Failure = FailingDisk::Failure;

class FailingDiskTest : public testing::Test {
 protected:
  static std::string bench() {
    BenchText text = repeatable_bench();
    text.stage_driver = text.accelerometer_driver = "simulated";
    text.protocol = "steps = 5\nstep_deg = 72.0\nsettle_s = 0.05\ndwell_readings = 10\n" +
                    text.protocol.substr(text.protocol.find("approach_deg"));
    return text.text();
  }

  void SetUp() override {
    InProcessRun whole(bench(), folder / "whole.run");
    disk.mend();
    whole.run_to_end();
    for (const Failure how : {Failure::kFull, Failure::kShortWrite, Failure::kInputOutput})
      calls[how] = disk.calls(how);
    ASSERT_TRUE(whole.finished());
    expected = numbers(result_json(result_of(whole.finished()->items.front().results, "abc")).dump());
    expected_bits = measured_bits(whole.path());
  }

  /// Every `stride`-th of the calls fails.
  void fail_all(std::size_t stride) {
    for (const auto& [how, count] : calls) {
      for (const bool lasts : {false, true}) {
        for (std::size_t at = 1; at <= count; at += stride) {
          examine(how, at, lasts);
          if (HasFatalFailure()) return;
        }
      }
    }
    fmt::print(
        "{} failures of the disk (a run makes {} writes, {} calls in all): {} runs completed all the same, "
        "{} "
        "ended with the reason, {} of them before there was a run, {} with all angles measured\n",
        tried, calls[Failure::kFull], calls[Failure::kInputOutput], unharmed, tried - unharmed, never_begun,
        all_measured);
    EXPECT_GT(all_measured, 0);
    EXPECT_GT(tried - unharmed - never_begun - all_measured, 0);
  }

  void examine(Failure how, std::size_t at, bool lasts) {
    InProcessRun run(bench(), folder / "a.run");
    disk.fail(how, at, lasts);
    std::string why;
    try {
      run.run_to_end();
    } catch (const RunFileError& error) {
      why = error.what();
    }
    ASSERT_TRUE(disk.failed()) << "no call " << at;
    SCOPED_TRACE(fmt::format("call {} ({}), failure {}{}: {}", at, *disk.failed(), static_cast<int>(how),
                             lasts ? " for good" : "", why.empty() ? "no error" : why));
    disk.mend();
    ++tried;
    EXPECT_FALSE(run.left_moving());
    if (why.empty()) {
      ++unharmed;
    } else {
      EXPECT_THAT(why, HasSubstr("a.run"));
      EXPECT_THAT(why, AnyOf(HasSubstr("the disk is full: free some space"),
                             HasSubstr("check its space and condition"), HasSubstr("is writable")));
    }
    if (!run.exists()) {
      ++never_begun;
      EXPECT_TRUE(run.reported().empty());
      EXPECT_EQ(std::distance(begin(std::filesystem::directory_iterator(folder.path())),
                              end(std::filesystem::directory_iterator())),
                2)
          << "something is left behind beside whole.run and its results";
    } else {
      check_kept(run, why);
    }
    run.run_to_end();
    check_complete(run);
    remove_run();
  }

  void check_kept(const InProcessRun& run, const std::string& why) {
    ASSERT_EQ(integrity(run.path()), "ok");
    const StoredRun stored = RunFile::load(run.path());
    EXPECT_THAT(stored.measured, testing::IsSupersetOf(run.reported()));
    const std::vector<std::string> bits = measured_bits(run.path());
    for (std::size_t k = 0; k < bits.size(); ++k) {
      if (bits[k].empty()) continue;
      EXPECT_EQ(bits[k], expected_bits.at(k)) << k;
    }
    all_measured += stored.measured.size() == stored.header.plan.size() && !why.empty() ? 1 : 0;
    EXPECT_TRUE(!why.empty() || stored.state == RunState::kComplete);
    // Where the disk takes it, the reason is in the file.
    if (stored.state == RunState::kInterrupted) {
      EXPECT_THAT(stored.events.back().text, HasSubstr("the stage is halted"));
    }
  }

  void check_complete(const InProcessRun& run) {
    EXPECT_EQ(RunFile::load(run.path()).state, RunState::kComplete);
    EXPECT_EQ(measured_bits(run.path()), expected_bits);
    if (run.finished()) {
      EXPECT_TRUE(numbers(result_json(result_of(run.finished()->items.front().results, "abc")).dump()) ==
                  expected);
    }
    for (const IntegrityCheck& check : verify_run(run.path()))
      EXPECT_TRUE(check.good) << check.what << ": " << check.found;
    EXPECT_FALSE(std::filesystem::exists(run.path().string() + "-wal"));
    EXPECT_EQ(integrity(run.path()), "ok");
  }

  void remove_run() {
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      if (entry.path().filename().string().starts_with("a.run")) std::filesystem::remove(entry.path());
  }

  test::TemporaryFolder folder;
  FailingDisk disk;
  std::map<Failure, std::size_t> calls;  ///< Number of calls in a whole run.
  nlohmann::json expected;
  std::vector<std::string> expected_bits;
  int tried = 0, unharmed = 0, never_begun = 0, all_measured = 0;
};

TEST_F(FailingDiskTest, TheRunCompletesOrEndsWithTheReasonAndGoesOnToTheSameBits) {
  fail_all(17);
}

class LongFailingDiskTest : public FailingDiskTest {};

TEST_F(LongFailingDiskTest, TheRunCompletesOrEndsWithTheReasonAndGoesOnToTheSameBits) {
  fail_all(1);
}

}  // namespace
}  // namespace abcal
