// Many runs one after the other in one process, with faults of instruments, wires, the world and the disk at
// random, resumed until they are complete: memory and descriptors stay constant, every run ends completed or
// with the reason, and results called usable are right.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <random>

#include "app/results/analysis/analyses.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/verify_run.h"
#include "sim/faults.h"
#include "tests/app/in_process_run.h"
#include "tests/app/instrument_cases.h"
#include "tests/app/repeatable_run.h"
#include "tests/support/failing_disk.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using test::FailingDisk;
using test::InProcessRun;

struct Resources {
  std::size_t heap_bytes = 0;      ///< In use.
  std::size_t resident_bytes = 0;  ///< Resident memory of the process.
  std::size_t descriptors = 0;

  static Resources now() {
    Resources r;
    const struct mallinfo2 heap = ::mallinfo2();
    r.heap_bytes = heap.uordblks + heap.hblkhd;
    std::size_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages >> pages;
    r.resident_bytes = pages * static_cast<std::size_t>(::getpagesize());
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator("/proc/self/fd"))
      ++r.descriptors;
    return r;
  }
};

class SoakTest : public testing::Test {
 protected:
  /// Allocators keep some of the returned memory; a leak of one reading (100 bytes) an angle would show.
  static constexpr double kMarginBytes = 1.5e6;

  void soak(std::size_t wanted) {
    std::optional<Resources> early;
    for (std::size_t n = 1; angles < wanted; ++n) {
      measure_one(n);
      if (HasFatalFailure()) return;
      if (!early && angles >= wanted / 10) early = Resources::now();
    }
    const Resources late = Resources::now();
    const auto megabytes = [](std::size_t bytes) { return 1e-6 * static_cast<double>(bytes); };
    fmt::print(
        "{} angles in {} runs: {} completed, {} refused to go on as the last angle read otherwise; {} "
        "interruptions ({} by instruments, {} by the disk), {} reconnections; {} results usable, {} of them "
        "farther than 4 u from the truth\nheap in use {:.2f} MB after a tenth, {:.2f} MB at the end; "
        "resident "
        "{:.1f} MB, {:.1f} MB; descriptors {}, {}\n",
        angles, completed + refused, completed, refused, by_instruments + by_disk, by_instruments, by_disk,
        reconnections, usable, wrong, megabytes(early->heap_bytes), megabytes(late.heap_bytes),
        megabytes(early->resident_bytes), megabytes(late.resident_bytes), early->descriptors,
        late.descriptors);
    EXPECT_LT(megabytes(late.heap_bytes), megabytes(early->heap_bytes) + 1e-6 * kMarginBytes);
    EXPECT_EQ(late.descriptors, early->descriptors);
    EXPECT_EQ(wrong, 0);
    EXPECT_GT(usable, completed / 2);
    EXPECT_GT(by_instruments, completed / 10);
    EXPECT_GT(by_disk, 0);
  }

  /// One run from its begin to its end, however often it is interrupted.
  void measure_one(std::size_t n) {
    const StageCase& stage = stages()[random() % stages().size()];
    const AccelerometerCase& accelerometer = accelerometers()[random() % accelerometers().size()];
    const std::string text =
        bench_text(stage, accelerometer, "simulated", "simulated", "simulated", "simulated");
    InProcessRun run(text, folder / "a.run");
    std::string story = fmt::format("run {}: {} with {}", n, stage.name, accelerometer.name);
    for (int attempt = 1;; ++attempt) {
      disk.mend();
      run.before_call = {};
      std::vector<FaultConfig> faults;
      if (attempt <= kTroubledAttempts) story += "; " + draw_trouble(stage, accelerometer, run, faults);
      run.change_bench = [&](BenchConfig& config) {
        config.simulation.seed = n;
        config.protocol.motion_timeout_s = 5.0;
        config.protocol.replug_timeout_s = 20.0;
        config.protocol.quiet_timeout_s = 2.0;
        config.faults = faults;
      };
      std::string why;
      try {
        run.run_to_end();
      } catch (const InstrumentError& error) {
        why = error.what();
        ++by_instruments;
      } catch (const RunFileError& error) {
        why = error.what();
        ++by_disk;
      }
      story += why.empty() ? "" : " -> " + why;
      SCOPED_TRACE(story);
      disk.mend();
      EXPECT_TRUE(!run.left_moving() || why.find("did not acknowledge the halt") != std::string::npos);
      if (why.empty()) break;
      if (run.exists()) {
        EXPECT_EQ(integrity(run.path()), "ok");
        EXPECT_THAT(RunFile::load(run.path()).measured, testing::IsSupersetOf(run.reported()));
      }
      if (why.find("begin a new run") != std::string::npos) {
        ++refused;
        angles += run.reported().size();
        remove_run();
        return;
      }
      ASSERT_LE(attempt, kTroubledAttempts) << "it does not go on without a fault";
    }
    SCOPED_TRACE(story);
    check_complete(run, text);
    remove_run();
  }

  void check_complete(const InProcessRun& run, const std::string& text) {
    ++completed;
    angles += run.reported().size();
    for (const IntegrityCheck& check : verify_run(run.path()))
      EXPECT_TRUE(check.good) << check.what << ": " << check.found;
    const StoredRun stored = RunFile::load(run.path());
    EXPECT_EQ(stored.measured.size(), stored.header.plan.size());
    reconnections += stored.record.reconnections;
    const CalibrationResult result = analyse(stored.record, "abc");
    if (result.verdict != Verdict::kUsable) return;
    ++usable;
    const TruthComparison truth = compare_with_truth(result, stored.record, parse_bench(text, "bench.toml"));
    if (truth.agrees()) return;
    ++wrong;
    ADD_FAILURE() << truth.text;
  }

  /// @return its description in words
  std::string draw_trouble(const StageCase& stage, const AccelerometerCase& accelerometer, InProcessRun& run,
                           std::vector<FaultConfig>& faults) {
    const auto uniform = [&] { return std::uniform_real_distribution<double>(0.0, 1.0)(random); };
    switch (random() % 4) {
      case 0:
        return "nothing";
      case 1: {
        const auto how = static_cast<FailingDisk::Failure>(random() % 3);
        const std::size_t at = 1 + random() % 700;
        const bool lasts = random() % 2 == 0;
        disk.fail(how, at, lasts);
        return fmt::format("disk fails in way {} at call {}{}", static_cast<int>(how), at,
                           lasts ? " on" : "");
      }
      case 2: {
        const std::size_t at = 1 + random() % 2000;
        const auto fault = static_cast<Fault>(random() % 10);
        run.before_call = [at, fault](std::string_view, std::size_t number) {
          if (number == at) throw InstrumentError("this instrument", fault, "scripted");
        };
        return fmt::format("{} at call {}", to_string(fault), at);
      }
      default: {
        const auto& all = sim::fault_descriptions();
        const sim::FaultDescription& kind = all[random() % all.size()];
        const bool chain = stage.name.starts_with("pi_") || stage.name.starts_with("zaber_");
        if (kind.kind == sim::FaultKind::kLostController && !chain) return "nothing";  // No other has chains.
        FaultConfig fault;
        fault.kind = kind.name;
        fault.at_s = 60.0 * uniform();
        if (random() % 3 != 0) fault.for_s = 3.0 * uniform();
        const bool of_stage = random() % 2 == 0;
        if (kind.on_the_wire && of_stage) {
          fault.instrument = stage.name == "two_controllers" ? "stage-z" : "stage";
        } else if (kind.on_the_wire) {
          fault.instrument = accelerometer.name == "scpi_single" ? "accelerometer-v" : "accelerometer";
        } else {
          fault.axis = of_stage ? "x" : "z";
        }
        fault.value = kind.kind == sim::FaultKind::kClippedOutput ? 0.5 * accelerometer.scale : 0.5;
        fault.text = "nothing that anyone can read\r\n";
        faults.push_back(fault);
        return fmt::format("{} on {} from {:.2f} s for {:.2f} s", kind.name,
                           kind.on_the_wire ? fault.instrument : fault.axis, fault.at_s,
                           fault.for_s.value_or(1e9));
      }
    }
  }

  void remove_run() {
    for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
      std::filesystem::remove(entry.path());
  }

  static constexpr int kTroubledAttempts = 4;

  test::TemporaryFolder folder;
  FailingDisk disk;
  std::mt19937_64 random{20261123};
  std::size_t angles = 0;
  int completed = 0, refused = 0, by_instruments = 0, by_disk = 0, reconnections = 0, usable = 0, wrong = 0;
};

TEST_F(SoakTest, FaultsAtRandomLeakNothingAndEveryRunEndsWell) {
  soak(500);
}

class LongSoakTest : public SoakTest {};

TEST_F(LongSoakTest, FaultsAtRandomLeakNothingAndEveryRunEndsWell) {
  soak(20000);
}

}  // namespace
}  // namespace abcal
