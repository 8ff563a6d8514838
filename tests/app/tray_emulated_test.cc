// Several items over pseudo-terminals in real time: nothing is lost, eight take the time of one, and what
// happens to one does not end the run of the others.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/result_text.h"
#include "protocol/record/verify_run.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/emulator_control.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

class LongTrayTest : public ProgramTest {
 protected:
  /// Replaces the first `before` from the position `from` on by `now`. @return its position
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
  /// The bench file with the links of the emulator.
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
    EXPECT_EQ(stored.measured.size(), stored.header.plan.size()) << k << "\n" << run.err << run.out;
    for (const DwellRecord& dwell : stored.dwells) EXPECT_EQ(dwell.lost, 0) << k;
    const TruthComparison comparison =
        compare_with_truth(analyse(stored.record, "joint"), stored.record, truth, k);
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

class LongTrayFaultTest : public LongTrayTest {
 protected:
  /// The example's first three items, at five angles in each experiment.
  LongTrayFaultTest() {
    std::string text = example();
    std::size_t at = 0;
    for (int item = 1; item <= 4; ++item) at = text.find("[[item]]", at + 1);
    text.erase(at);
    replace(text, "steps = 12\nstep_deg = 30.0", "steps = 5\nstep_deg = 72.0\nreplug_timeout_s = 30.0");
    test::write_file(folder / "emulated.toml", text);
    test::write_file(folder / "bench.toml", wired(text));
    emulator = std::make_unique<test::Program>(
        std::vector<std::string>{"emulate", "emulated.toml", "--link-dir", "links", "--control", "0"},
        folder.path());
    if (!test::wait_for([&] { return emulator->out().find("Serving") != std::string::npos; },
                        std::chrono::seconds(60)))
      throw std::runtime_error(emulator->err());
    const std::string out = emulator->out();
    const std::size_t port = out.find("127.0.0.1:") + 10;
    control = std::make_unique<test::EmulatorControlClient>(
        static_cast<std::uint16_t>(std::stoi(out.substr(port, out.find('\n', port) - port))));
  }
  void unplug_second(const nlohmann::json& more = nlohmann::json::object()) {
    nlohmann::json request{{"do", "fault"}, {"kind", "unplug"}, {"instrument", "item-2"}};
    request.update(more);
    (void)control->ask(request);
  }
  std::size_t measured() const {
    try {
      return RunFile::load(folder / "a.run").measured.size();
    } catch (const RunFileError&) {
      return 0;
    }
  }
  void expect_sound_file() const {
    for (const IntegrityCheck& check : verify_run(folder / "a.run"))
      EXPECT_TRUE(check.good) << check.what << ": " << check.found;
  }

  std::unique_ptr<test::Program> emulator;
  std::unique_ptr<test::EmulatorControlClient> control;
};

TEST_F(LongTrayFaultTest, OneThatIsUnpluggedAndComesBackGoesOn) {
  test::Program run({"run", "bench.toml", "-o", "a.run"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return measured() >= 4; }, std::chrono::seconds(240))) << run.err();
  unplug_second({{"for_s", 2.0}});
  (void)run.wait();  // The exit code does not matter: so few angles may not suffice for a result.
  ASSERT_EQ(RunFile::load(folder / "a.run").state, RunState::kComplete) << run.err();
  for (int k = 1; k <= 3; ++k) {
    const StoredRun stored = RunFile::load(folder / "a.run", k);
    EXPECT_EQ(stored.measured.size(), stored.header.plan.size()) << k;
    EXPECT_FALSE(stored.items.at(static_cast<std::size_t>(k - 1)).dropped_at) << k;
    EXPECT_EQ(std::ranges::count(stored.events, kReconnectedEvent, &RunEvent::kind), 1) << k;
  }
  expect_sound_file();
}

TEST_F(LongTrayFaultTest, OneThatIsDeadFromTheStartIsSaidAndLeftOutIfAsked) {
  unplug_second();
  const std::filesystem::path link = folder / "links/item-2";
  ASSERT_TRUE(
      test::wait_for([&] { return !std::filesystem::is_symlink(std::filesystem::symlink_status(link)); },
                     std::chrono::seconds(60)));
  const test::ProgramResult refused = abcal({"run", "bench.toml", "-o", "a.run"});
  EXPECT_NE(refused.exit_code, 0);
  EXPECT_THAT(refused.err, testing::AllOf(testing::HasSubstr("1 of 3 are not there"),
                                          testing::HasSubstr("--without-missing-items")));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
  const test::ProgramResult run = abcal({"run", "bench.toml", "-o", "a.run", "--without-missing-items"});
  ASSERT_TRUE(std::filesystem::exists(folder / "a.run")) << run.err;
  const StoredRun stored = RunFile::load(folder / "a.run");
  ASSERT_EQ(stored.state, RunState::kComplete) << run.err;
  EXPECT_EQ(stored.measured.size(), stored.header.plan.size());
  EXPECT_EQ(stored.items.at(1).dropped_at, 0U);
  EXPECT_EQ(RunFile::load(folder / "a.run", 3).measured.size(), stored.header.plan.size());
  EXPECT_EQ(run.exit_code, 1) << "an item was left out";
  expect_sound_file();
}

}  // namespace
}  // namespace abcal
