// Eight items over pseudo-terminals in real time: nothing is lost, and they take the time of one.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>

#include "app/bench/bench_config.h"
#include "app/results/analyses.h"
#include "app/results/result_text.h"
#include "protocol/record/verify.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

class LongTrayTest : public ProgramTest {
 protected:
  /// Puts `now` in place of the first `before` from `from` on. @return where it stands
  static std::size_t replace(std::string& text, const std::string& before, const std::string& now,
                             std::size_t from = 0) {
    const std::size_t at = text.find(before, from);
    if (at == std::string::npos) throw std::invalid_argument("the example has no " + before);
    text.replace(at, before.size(), now);
    return at + now.size();
  }
  /// The example, with fewer angles.
  static std::string example() {
    std::string text = test::read_file(test::source_folder() / "docs/examples/tray.toml");
    replace(text, "steps = 24\nstep_deg = 15.0", "steps = 12\nstep_deg = 30.0");
    replace(text, "settle_s = 2.0", "settle_s = 0.5");
    replace(text, "dwell_readings = 300", "dwell_readings = 150");
    return text;
  }
  /// The same with the links of the emulator.
  static std::string wired(std::string text) {
    const std::string port = "port = \"simulated\"";
    std::size_t at = replace(text, port, "port = \"links/stage\"");
    for (int item = 1; text.find(port, at) != std::string::npos; ++item)
      at = replace(text, port, "port = \"links/item-" + std::to_string(item) + "\"", at);
    return text;
  }
};

TEST_F(LongTrayTest, EightItemsInRealTimeTakeTheTimeOfOneAndLoseNothing) {
  const std::string eight = example();
  const std::string one = eight.substr(0, eight.find("[[item]]", eight.find("[[item]]") + 1));
  test::write_file(folder / "emulated.toml", eight);
  const test::Program emulator({"emulate", "emulated.toml", "--link-dir", "links"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return emulator.out().find("Serving") != std::string::npos; },
                             std::chrono::seconds(60)))
      << emulator.err();
  test::write_file(folder / "eight.toml", wired(eight));
  test::write_file(folder / "one.toml", wired(one));
  const test::ProgramResult run = abcal({"run", "eight.toml", "-o", "eight.run"});
  ASSERT_TRUE(std::filesystem::exists(folder / "eight.run")) << run.err;
  ASSERT_EQ(RunFile::load(folder / "eight.run").state, RunState::kComplete) << run.err << run.out;
  ASSERT_TRUE(std::filesystem::exists(folder / "eight.run.results"));
  (void)abcal({"run", "one.toml", "-o", "one.run"});

  const BenchConfig truth = parse_bench(eight, "eight");
  for (int k = 1; k <= 8; ++k) {
    const StoredRun stored = RunFile::load(folder / "eight.run", k);
    EXPECT_EQ(stored.measured.size(), stored.header.plan.size()) << k;
    for (const DwellRecord& dwell : stored.dwells) EXPECT_EQ(dwell.lost, 0) << k;
    const TruthComparison comparison =
        compare_with_truth(analyse(stored.record, "joint"), for_item(truth, k));
    EXPECT_TRUE(comparison.agrees()) << k << "\n" << comparison.text;
  }
  for (const IntegrityCheck& check : verify_run(folder / "eight.run"))
    EXPECT_TRUE(check.good) << check.what << ": " << check.found;
  const double together_s = RunFile::load(folder / "eight.run").timing.total_s();
  const double alone_s = RunFile::load(folder / "one.run").timing.total_s();
  RecordProperty("eight_items_s", std::to_string(together_s));
  RecordProperty("one_item_s", std::to_string(alone_s));
  EXPECT_LT(together_s, 1.02 * alone_s);
}

}  // namespace
}  // namespace abcal
