// Runs that are killed or unplugged at random moments: nothing measured is lost, and the results equal those
// of an undisturbed run. A few under the label quick, as many as a laboratory sees in years under long.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <random>

#include "tests/app/program_fixtures.h"
#include "tests/app/repeatable_run.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::Program;
using test::ProgramResult;
using testing::HasSubstr;

class SurvivalTest : public ProgramTest {
 protected:
  void kill_runs(int wanted) {
    write_bench(repeatable_bench());
    const std::chrono::duration<double> measuring = measure_undisturbed();
    const nlohmann::json expected =
        numbers(abcal({"analyse", "whole.run", "--estimator", "abc", "--json"}).out);
    const std::vector<std::string> expected_bits = measured_bits(folder / "whole.run");

    std::mt19937_64 random(20261121);
    std::uniform_real_distribution<double> moment(0.0, 1.0);
    int killed = 0, killed_again = 0, before_the_first_angle = 0, killed_when_complete = 0;
    for (int attempt = 0; killed < wanted; ++attempt) {
      ASSERT_LT(attempt, 20 * wanted) << "the runs end before they can be killed";
      SCOPED_TRACE(fmt::format("attempt {}", attempt));
      const std::string name = fmt::format("{}.run", attempt);
      const std::filesystem::path path = folder / name;
      const auto kill_at_random = [&](Program& program) {
        const auto wait = std::chrono::duration_cast<std::chrono::milliseconds>(measuring * moment(random));
        test::wait_for([&] { return !program.running(); }, wait);
        program.signal(SIGKILL);
        return program.wait() == 128 + SIGKILL;
      };
      {
        Program run({"run", "bench.toml", "-o", name}, folder.path());
        ASSERT_TRUE(test::wait_for([&] { return std::filesystem::exists(path) || !run.running(); }, 20s));
        if (!kill_at_random(run)) continue;  // It was done.
      }
      ++killed;
      std::size_t kept = measured(name);  // Before anything else touches the file.
      ASSERT_EQ(integrity(path), "ok");
      before_the_first_angle += kept == 0 ? 1 : 0;
      if (killed % 2 == 0) {
        Program second({"resume", name}, folder.path());
        if (kill_at_random(second)) ++killed_again;
        ASSERT_EQ(integrity(path), "ok");
        EXPECT_GE(measured(name), kept);
        kept = measured(name);
      }
      const bool complete = RunFile::load(path).state == RunState::kComplete;
      const ProgramResult resumed = abcal({"resume", name, "--full"});
      if (complete) {
        // Closed or analysed now, if it was not; a closed one cannot be resumed.
        EXPECT_TRUE(resumed.exit_code == 0 || resumed.err.find("closed run") != std::string::npos)
            << resumed.err;
        ++killed_when_complete;
      } else {
        ASSERT_EQ(resumed.exit_code, 0) << resumed.err;
        EXPECT_THAT(test::unwrapped(resumed.out), HasSubstr("the run was interrupted and resumed"));
      }
      EXPECT_EQ(integrity(path), "ok");
      const std::vector<std::string> bits = measured_bits(path);
      for (std::size_t k = 0; k < bits.size(); ++k)
        EXPECT_EQ(bits[k], expected_bits.at(k)) << "angle " << k << " of those kept at the kill: " << kept;
      EXPECT_TRUE(numbers(abcal({"analyse", name, "--estimator", "abc", "--json"}).out) == expected);
      const ProgramResult verified = abcal({"verify", name});
      EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
      for (const auto& entry : std::filesystem::directory_iterator(folder.path()))
        if (entry.path().filename().string().starts_with(fmt::format("{}.", attempt)))
          std::filesystem::remove(entry.path());
    }
    fmt::print(
        "{} of {} killed runs resumed, {} of them killed a second time, {} before their first angle, {} "
        "after "
        "their last\n",
        killed, wanted, killed_again, before_the_first_angle, killed_when_complete);
    RecordProperty("killed", killed);
  }

  /// Makes whole.run. @return real time from the first sight of its file to its last angle: analysis and
  /// certificates of a short run take longer than that, and kills are to meet the measuring
  std::chrono::duration<double> measure_undisturbed() {
    Program run({"run", "bench.toml", "-o", "whole.run"}, folder.path());
    EXPECT_TRUE(test::wait_for([&] { return std::filesystem::exists(folder / "whole.run"); }, 20s));
    const auto begin = std::chrono::steady_clock::now();
    const auto all_measured = [&] {
      try {
        const StoredRun stored = RunFile::load(folder / "whole.run");
        return stored.measured.size() == stored.header.plan.size() && !stored.measured.empty();
      } catch (const RunFileError&) {  // It is still being made.
        return !run.running();
      }
    };
    EXPECT_TRUE(test::wait_for(all_measured, 60s));
    const auto end = std::chrono::steady_clock::now();
    EXPECT_EQ(run.wait(), 0) << run.err();
    return end - begin;
  }

  /// Instruments vanish and come back (or not) at random moments of runs in simulated time.
  void unplug_runs(int wanted) {
    BenchText bench = repeatable_bench();
    bench.protocol = "replug_timeout_s = 20.0\n" + bench.protocol;
    write_bench(bench);
    const ProgramResult undisturbed = abcal({"run", "bench.toml", "-o", "whole.run"});
    ASSERT_EQ(undisturbed.exit_code, 0) << undisturbed.err;
    const double whole_s = RunFile::load(folder / "whole.run").timing.total_s();
    std::mt19937_64 random(20261122);
    std::uniform_real_distribution<double> at(0.0, 1.0);
    int completed = 0, halted = 0, noticed = 0;
    for (int k = 0; k < wanted; ++k) {
      const bool stage = random() % 2 == 0, comes_back = random() % 5 != 0;
      const double at_s = whole_s * at(random), for_s = comes_back ? 15.0 * at(random) : 1e6;
      SCOPED_TRACE(fmt::format("{}: {} at {} s for {} s", k, stage ? "stage" : "accelerometer", at_s, for_s));
      BenchText unplugged = bench;
      test::write_file(folder / "unplugged.toml",
                       unplugged.text() + fmt::format("[[fault]]\nkind = \"unplug\"\ninstrument = \"{}\"\n"
                                                      "at_s = {}\nfor_s = {}\n",
                                                      stage ? "stage" : "accelerometer", at_s, for_s));
      const std::string name = fmt::format("unplugged-{}.run", k);
      const ProgramResult run = abcal({"run", "unplugged.toml", "-o", name, "--full"});
      if (!std::filesystem::exists(folder / name)) {  // Unplugged before the identification.
        EXPECT_EQ(run.exit_code, 3) << run.err;
        ++halted;
        continue;
      }
      const StoredRun stored = RunFile::load(folder / name);
      if (run.exit_code == 0) {
        ++completed;
        noticed += stored.record.reconnections;
        EXPECT_EQ(measured_bits(folder / name), measured_bits(folder / "whole.run"));
        EXPECT_EQ(test::unwrapped(run.out).find("came back once") != std::string::npos,
                  stored.record.reconnections == 1);
        EXPECT_EQ(abcal({"verify", name}).exit_code, 0);
      } else {
        ++halted;
        EXPECT_FALSE(comes_back);
        EXPECT_EQ(run.exit_code, 3) << run.err;
        EXPECT_THAT(run.err, AllOf(HasSubstr("did not come back within 20 s"), HasSubstr("abcal resume")));
        EXPECT_EQ(run.err.find("the stage is halted") != std::string::npos, !stage) << run.err;
        EXPECT_EQ(stored.state, RunState::kInterrupted);
        EXPECT_THAT(stored.events.back().text, HasSubstr("did not come back"));
      }
    }
    EXPECT_GT(noticed, 0);
    fmt::print("{} of {} unplugged runs: {} completed ({} reconnections), {} halted with the reason\n",
               completed + halted, wanted, completed, noticed, halted);
  }

  std::size_t measured(const std::string& run) { return RunFile::load(folder / run).measured.size(); }
};

TEST_F(SurvivalTest, KilledRunsGoOnAndGiveTheSameBits) {
  kill_runs(20);
}

TEST_F(SurvivalTest, UnpluggedRunsGoOnWithTheSameBitsOrHaltAndSaySo) {
  unplug_runs(10);
}

/// Pseudo-terminals that close and open again under the same name, again and again, in real time.
class ReplugTest : public EmulatedBenchTest {
 protected:
  void unplug_all_the_time(std::uint64_t seed) {
    bench.protocol += "replug_timeout_s = 30.0\n[limits]\nmax_replugs = 1000\n";
    write_bench(bench);
    std::string faults;
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    double at_s = 2.0;
    for (int k = 0; k < 40; ++k, at_s += 3.0 + 3.0 * uniform(random)) {
      faults += fmt::format("[[fault]]\nkind = \"unplug\"\ninstrument = \"{}\"\nat_s = {}\nfor_s = {}\n",
                            random() % 2 == 0 ? "stage" : "accelerometer", at_s, 0.2 + 0.6 * uniform(random));
    }
    test::write_file(folder / "emulated.toml", bench.text() + faults);
    Program serving({"emulate", "emulated.toml", "--link-dir", "links"}, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return std::filesystem::exists(folder / "links/accelerometer"); }, 20s))
        << serving.err();
    const ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run"});
    ASSERT_EQ(run.exit_code, 0) << run.err << "The emulator: " << serving.err();
    const StoredRun stored = RunFile::load(folder / "a.run");
    EXPECT_EQ(stored.measured.size(), stored.header.plan.size());
    EXPECT_GT(stored.record.reconnections, 2) << run.err;
    EXPECT_THAT(test::unwrapped(abcal({"analyse", "a.run", "--full"}).out),
                HasSubstr("with the same serial number where it has one"));
    fmt::print("{} reconnections in one run of {:.1f} s\n", stored.record.reconnections,
               stored.timing.total_s());
    reconnections += stored.record.reconnections;
    const ProgramResult truth = abcal({"analyse", "a.run", "--truth", "bench.toml"});
    EXPECT_EQ(truth.exit_code, 0) << truth.out;
  }
  int reconnections = 0;
};

TEST_F(ReplugTest, ARunGoesOnWhateverIsUnpluggedForAWhile) {
  unplug_all_the_time(1);
}

class LongReplugTest : public ReplugTest, public testing::WithParamInterface<std::uint64_t> {};

TEST_P(LongReplugTest, ARunGoesOnWhateverIsUnpluggedForAWhile) {
  unplug_all_the_time(GetParam());
}

INSTANTIATE_TEST_SUITE_P(Seeds, LongReplugTest, testing::Range<std::uint64_t>(2, 12));

class LongSurvivalTest : public SurvivalTest {};

TEST_F(LongSurvivalTest, UnpluggedRunsGoOnWithTheSameBitsOrHaltAndSaySo) {
  unplug_runs(100);
}

TEST_F(LongSurvivalTest, KilledRunsGoOnAndGiveTheSameBits) {
  kill_runs(200);
}

}  // namespace
}  // namespace abcal
