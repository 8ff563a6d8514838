#include "app/results/analysis/tray_results.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/results/analysis/analyses.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/report_data.h"
#include "app/results/report/calibration_document.h"
#include "app/system/real_clock.h"
#include "protocol/uncertainty/budget.h"
#include "tests/protocol/estimators/made_tray.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

using nlohmann::json;
using testing::HasSubstr;

/// A run file of three items that were measured together; the third was dropped after some angles.
class TrayResultsTest : public testing::Test {
 protected:
  static constexpr int kSteps = 12;
  static constexpr std::size_t kDroppedAt = 8;

  TrayResultsTest() : tray(test::made_tray({.items = 3, .steps = kSteps, .mixed_mounting = false}, 21)) {
    RunFile file = RunFile::create(path, header());
    for (std::size_t n = 0; n < tray.records[0].dwells.size(); ++n) {
      std::vector<ItemDwell> dwells;
      for (int k = 1; k <= 3; ++k) {
        if (k < 3 || n < kDroppedAt)
          dwells.push_back({k, tray.records[static_cast<std::size_t>(k - 1)].dwells[n], {}});
      }
      if (n == kDroppedAt) file.drop_item(3, n, "2026-03-01T10:00:00Z", Message("it fell silent"));
      file.append_dwells(n, dwells, {});
    }
  }

  RunHeader header() const {
    RunHeader out;
    out.response_unit = "V";  // Nothing is expected of a voltage.
    out.tolerances = tray.records[0].tolerances;
    out.labels = {{"item.serial_number", "s1"}};
    out.steps = kSteps;
    out.items.resize(3);
    for (int k = 1; k <= 3; ++k) {
      RunItem& item = out.items[static_cast<std::size_t>(k - 1)];
      item.k = k;
      item.maker = "maker";
      item.serial_number = "s" + std::to_string(k);
      if (k == 1) continue;
      ItemFacts facts;
      facts.labels = {{"item.serial_number", item.serial_number}};
      facts.response_unit = "V";
      facts.tolerances = tray.records[0].tolerances;
      out.further_items.push_back(facts);
    }
    for (const DwellRecord& dwell : tray.records[0].dwells)
      out.plan.push_back({dwell.experiment, dwell.n, false, dwell.alpha, Angle{}, Angle{}});
    return out;
  }

  test::TemporaryFolder folder;
  std::filesystem::path path = folder / "several.run";
  test::MadeTray tray;
};

TEST_F(TrayResultsTest, JsonHasEveryItemTheStageOnceAndWhatTheyShare) {
  const AnalysedRun run = analyse_run(RunFile::load_items(path));
  const json out = json::parse(tray_json(run).dump());
  EXPECT_EQ(out["schema"], "abcal.tray/1");
  EXPECT_EQ(out["verdict"], "doubtful") << out["why"];
  ASSERT_EQ(out["items"].size(), 3U);
  EXPECT_EQ(out["items"][1]["serial_number"], "s2");
  for (int k = 0; k < 2; ++k) {
    EXPECT_EQ(out["items"][k]["result"]["schema"], "abcal.result/1");
    EXPECT_TRUE(out["items"][k]["in_common_fit"]) << out["items"][k]["why_not_in_common_fit"];
  }
  EXPECT_FALSE(out["items"][2]["in_common_fit"]);
  ASSERT_EQ(out["dropped"].size(), 1U);
  EXPECT_EQ(out["dropped"][0]["k"], 3);
  EXPECT_EQ(out["dropped"][0]["reason"], "it fell silent");
  EXPECT_EQ(out["stage"]["items"], 2);
  EXPECT_EQ(out["stage"]["angles"].size(), 3U * kSteps);
  ASSERT_EQ(out["covariance_between_items"].size(), 1U);
  EXPECT_EQ(out["covariance_between_items"][0]["items"], json::parse("[1, 2]"));
  EXPECT_EQ(out["covariance_between_items"][0]["covariance"].size(), 12U);
  EXPECT_THAT(tray_text(run, stdout), HasSubstr("dropped before angle 9: it fell silent"));
}

TEST_F(TrayResultsTest, ReportOfAnItemHasTheResultOfTheCommonFit) {
  const AnalysedRun run = analyse_run(RunFile::load_items(path));
  const ReportData data = gather_report(path, RealClock().utc_now(), 2);
  EXPECT_EQ(data.label("item.serial_number"), "s2");
  ASSERT_TRUE(data.is_one_of_several());
  const CalibrationResult& joint = result_of(data.results, "joint");
  EXPECT_EQ(joint.sensitivity_values(), run.joint.items[1].result.sensitivity_values());
  const Budget budget = make_budget(data.record, joint);
  const auto others = std::find_if(budget.lines.begin(), budget.lines.end(), [](const auto& line) {
    return line.input.english().starts_with("effects of the other items");
  });
  ASSERT_NE(others, budget.lines.end());
  EXPECT_EQ(others->standard_uncertainty, 1.0);
  EXPECT_EQ(others->unit, "1");
  EXPECT_TRUE(others->contribution.allFinite());
  // Analysed alone, the item is known less well.
  const CalibrationResult alone = analyse(data.record, "joint");
  EXPECT_LT(joint.offset[0].standard_uncertainty, alone.offset[0].standard_uncertainty);
  bool found = false;
  for (const Section& section : calibration_document(data).sections)
    found = found || section.title == "Items measured together";
  EXPECT_TRUE(found);
}

TEST_F(TrayResultsTest, CommandsAskForAnItemThatTheRunHas) {
  EXPECT_EQ(chosen_item(path, 3), 3);
  for (const int none : {-1, 0, 4}) EXPECT_THROW(chosen_item(path, none), std::invalid_argument);
}

TEST_F(TrayResultsTest, RunEndsWithWhatAnalyseSays) {
  std::string bench = test::read_file(test::source_folder() / "docs/examples/tray.toml");
  const std::size_t steps = bench.find("steps = 24");
  ASSERT_NE(steps, std::string::npos);
  test::write_file(folder / "tray.toml", bench.replace(steps, 10, "steps = 12"));
  const test::ProgramResult ran =
      test::run_program({"run", "tray.toml", "-o", "tray.run", "--json"}, folder.path());
  EXPECT_EQ(ran.exit_code, 0) << ran.err;
  json told = json::parse(ran.out);
  EXPECT_EQ(told["run"]["state"], "complete");
  EXPECT_EQ(told["run"]["file"], "tray.run");
  EXPECT_EQ(told["items"].size(), 8U);
  told.erase("run");
  EXPECT_EQ(told, json::parse(test::run_program({"analyse", "tray.run", "--json"}, folder.path()).out));
}

TEST_F(TrayResultsTest, ProgramAnalysesAllItemsOrOne) {
  const auto run = [&](std::vector<std::string> arguments) {
    return test::run_program(arguments, folder.path());
  };
  const json all = json::parse(run({"analyse", path, "--json"}).out);
  EXPECT_EQ(all["schema"], "abcal.tray/1");
  const json second =
      json::parse(run({"analyse", path, "--item", "2", "--estimator", "joint", "--json"}).out);
  EXPECT_EQ(second, all["items"][1]["result"]);
  const json alone = json::parse(run({"analyse", path, "--item", "2", "--estimator", "abc", "--json"}).out);
  EXPECT_EQ(alone["estimator"], "abc");
  EXPECT_THAT(run({"analyse", path, "--full"}).out, HasSubstr("Stage, from the readings of 2 items"));
  const test::ProgramResult no_such = run({"analyse", path, "--item", "4"});
  EXPECT_EQ(no_such.exit_code, 2);
  EXPECT_THAT(no_such.err, HasSubstr("has 3 items; required: 1 to 3"));
  EXPECT_EQ(run({"report", path, "--item", "2", "--csv", "two.csv"}).exit_code, 0);
  const test::ProgramResult averaged = run({"analyse", "two.csv", "--json"});
  EXPECT_EQ(averaged.exit_code, 0) << averaged.err;
  const test::ProgramResult all_by_abc = run({"analyse", path, "--estimator", "abc"});
  EXPECT_EQ(all_by_abc.exit_code, 2);
  EXPECT_THAT(all_by_abc.err, HasSubstr("required: --item as well"));
  EXPECT_THAT(run({"report", path}).err, HasSubstr("required: --item 1 to 3"));
  const json report = json::parse(run({"report", path, "--item", "2", "--json"}).out);
  EXPECT_EQ(report["item"]["serial_number"], "s2");
  EXPECT_THAT(run({"export", path, "--as", "json"}).err, HasSubstr("required: --item 1 to 3"));
  const test::ProgramResult exported = run({"export", path, "--item", "2", "--as", "json"});
  EXPECT_EQ(exported.exit_code, 0) << exported.err;
  EXPECT_THAT(exported.out, HasSubstr("s2"));
}

// The joint result of an item is that of the common fit: its uncertainties, and trials of it all.
TEST_F(TrayResultsTest, UncertaintyOfACommonFitIsThatOfItsTrials) {
  const auto json_of = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--estimator", "joint", "--trials", "40", "--json"});
    const test::ProgramResult result = test::run_program(arguments, folder.path());
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return json::parse(result.out);
  };
  const json study = json_of({"uncertainty", path, "--item", "2"});
  EXPECT_EQ(study.at("estimator"), "joint");
  ASSERT_EQ(study.at("cases").size(), 1U);
  EXPECT_EQ(study.at("cases").at(0).at("trials"), 40);
  EXPECT_FALSE(study.contains("no_trials"));
  const AnalysedRun run = analyse_run(load_items(path), "joint");
  EXPECT_EQ(study.at("posterior").at("standard_uncertainty").at("offset").at(0).get<double>(),
            run.item(2).results.front().offset[0].standard_uncertainty);
}

TEST_F(TrayResultsTest, UncertaintyIsThatOfTheItem) {
  const auto run = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.end(), {"--estimator", "abc", "--trials", "2000", "--json"});
    return test::run_program(arguments, folder.path());
  };
  const test::ProgramResult refused = run({"uncertainty", path});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("has 3 items; required: --item 1 to 3"));
  for (const std::string item : {"1", "2"}) {
    const test::ProgramResult of_item = run({"uncertainty", path, "--item", item});
    ASSERT_EQ(of_item.exit_code, 0) << of_item.err;
    // The averaged readings of the item alone say the same.
    ASSERT_EQ(
        test::run_program({"report", path, "--item", item, "--csv", item + ".csv"}, folder.path()).exit_code,
        0);
    json of_copy = json::parse(run({"uncertainty", item + ".csv"}).out), of_run = json::parse(of_item.out);
    for (json* each : {&of_copy, &of_run}) each->erase("source");
    EXPECT_EQ(of_run, of_copy) << item;
  }
  EXPECT_NE(run({"uncertainty", path, "--item", "1"}).out, run({"uncertainty", path, "--item", "2"}).out);
  EXPECT_EQ(load_record(path.string() + "#2").run->own_item().serial_number, "s2");
  EXPECT_THROW(load_record(path.string() + "#4"), std::invalid_argument);
  EXPECT_THROW(load_record(path.string() + "#x"), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
