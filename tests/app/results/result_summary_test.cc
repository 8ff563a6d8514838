// The first screen of a result: 80 columns, verdict first, warnings that lead on.

#include "app/results/analysis/result_summary.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "app/results/analysis/result_text.h"
#include "app/results/analysis/size_costs.h"
#include "app/system/text_layout.h"
#include "protocol/uncertainty/budget.h"
#include "tests/protocol/estimators/made_record.h"
#include "tests/protocol/estimators/made_tray.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

std::vector<std::string> lines_of_text(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

/// Promises of every first screen.
void expect_first_screen(const std::string& text, const std::string& verdict, const std::string& file) {
  const std::vector<std::string> lines = lines_of_text(text);
  ASSERT_FALSE(lines.empty());
  EXPECT_THAT(lines.front(), StartsWith("Result: " + verdict));
  for (const std::string& line : lines) EXPECT_LE(display_width(line), 80U) << line;
  EXPECT_EQ(lines.back(), "File: " + file);
  // Every warning ends with a command or a page.
  bool waits = false;
  for (const std::string& line : lines) {
    if (line.starts_with("  - ") || line == lines.back()) {
      EXPECT_FALSE(waits) << "a warning leads nowhere, before: " << line;
      waits = line.starts_with("  - ");
    } else if (waits && line.starts_with("    -> ")) {
      EXPECT_THAT(line, testing::AnyOf(StartsWith("    -> abcal "), StartsWith("    -> docs/")));
      waits = false;
    }
  }
}

class ResultSummaryTest : public testing::Test {
 protected:
  static RunRecord record_of(const EffectSizes& sizes = {}) {
    AccelerometerModel accelerometer;
    accelerometer.sensitivity_matrix << 1.0021, -0.0047, 0.0037, 0.0069, 0.9982, 0.0086, -0.0117, 0.0064,
        1.0009;
    accelerometer.offset << 0.0054, -0.0183, 0.0226;
    RunRecord record = test::made_record(accelerometer, {}, 36, Angle::degrees(10.0));
    record.response_unit = "g";
    record.tolerances = sizes;
    std::mt19937_64 engine(7);
    test::add_noise(record, 2e-5, engine);
    return record;
  }
  static AnalysedItem analysed(const std::string& estimator, const RunRecord& record = record_of()) {
    AnalysedItem item;
    item.stored.record = record;
    item.results.push_back(analyse(record, estimator));
    return item;
  }
  static std::string shown(const AnalysedItem& item, const std::string& file = "a.run") {
    return summary_text(item, file, stdout);
  }
};

TEST_F(ResultSummaryTest, EveryEstimatorFitsTheScreen) {
  for (const std::string& estimator : estimator_names()) {
    const AnalysedItem item = analysed(estimator);
    ASSERT_NE(item.results.front().verdict, Verdict::kNotUsable) << item.results.front().why;
    const std::string text = shown(item);
    expect_first_screen(text, to_string(item.results.front().verdict).data(), "a.run");
    EXPECT_THAT(text, AllOf(HasSubstr("\n  u  "), HasSubstr("uv +"), HasSubstr("95.45 %")));
    const bool has_matrix = estimator != "norm";
    EXPECT_LE(lines_of_text(text).size(), 22U) << text;
    const std::string full = full_text(item, "a.run", stdout);
    EXPECT_EQ(full.find("s_ux") != std::string::npos, has_matrix);
    EXPECT_EQ(full.find("What dominates U") != std::string::npos, has_matrix);
  }
}

TEST_F(ResultSummaryTest, UIsTheExpandedUncertaintyAndNotTheStandardOne) {
  AnalysedItem item = analysed("joint");
  Quantity& s = item.results.front().intrinsic_sensitivity[0];
  s = {1.0021234, 0.0000050, {}, {}, "g/g_loc", 4.0};  // k = 2.87 for 4 degrees of freedom
  EXPECT_THAT(shown(item), HasSubstr("+1.002123 +- 0.000014"));
  EXPECT_THAT(full_text(item, "a.run", stdout), HasSubstr("2.87"));
}

TEST_F(ResultSummaryTest, LongNamesWideValuesAndManyNotesStayInside) {
  std::mt19937_64 engine(20261125);
  const std::vector<std::string> serials{"SN-1", std::string(150, '7'),
                                         "加速度計加速度計加速度計加速度計加速度計"
                                         "加速度計加速度計加速度計",
                                         "a\x1b[2Jb", "two words of a serial number"};
  const std::vector<std::string> units{"g", "V", "m/s2", "LSB", "mV/V of the bridge"};
  for (int trial = 0; trial < 200; ++trial) {
    AnalysedItem item = analysed(trial % 2 == 0 ? "joint" : "norm");
    CalibrationResult& result = item.results.front();
    const auto one_of = [&](const auto& list) { return list[engine() % list.size()]; };
    item.stored.header.labels = {
        {"item.maker", "Maker & Söhne"}, {"item.model", "model"}, {"item.serial_number", one_of(serials)}};
    const std::string unit = one_of(units);
    const double scale = std::pow(10.0, static_cast<double>(engine() % 16) - 8.0);
    const auto change = [&](Quantity& q) {
      q.value *= scale;
      q.standard_uncertainty *= scale * std::pow(10.0, -static_cast<double>(engine() % 6));
      q.unit = unit + "/g_loc";
    };
    if (result.sensitivity_matrix) {
      for (auto& row : *result.sensitivity_matrix)
        for (Quantity& q : row) change(q);
    }
    for (Quantity& q : result.intrinsic_sensitivity) change(q);
    for (Quantity& q : result.offset) change(q);
    result.verdict = static_cast<Verdict>(engine() % 3);
    for (std::size_t notes = engine() % 4; notes > 0; --notes)
      result.diagnostics.notes.push_back(
          Message::bare("a note of " + std::string(engine() % 120, 'x') + " many words " + one_of(serials)));
    result.why = Message::bare("a reason of " + std::string(engine() % 200, 'y') + " words");
    std::string verdict(to_string(result.verdict));
    std::ranges::replace(verdict, '_', ' ');
    const std::string text = shown(item);
    expect_first_screen(text, verdict, "a.run");
    if (HasFailure()) FAIL() << text;
  }
}

TEST_F(ResultSummaryTest, NamesOfFilesAndCommandsStayWhole) {
  AnalysedItem item = analysed("joint");
  const std::string file = "/a/long/path/" + std::string(100, 'p') + "/a.run";
  item.results.front().verdict = Verdict::kDoubtful;
  EXPECT_THAT(shown(item, file), AllOf(HasSubstr("\nFile: " + file + "\n"),
                                       HasSubstr("-> abcal analyse " + file + " --full\n")));
}

TEST_F(ResultSummaryTest, AResultThatIsNotUsableHasNoNumbers) {
  RunRecord record = record_of();
  record.dwells.resize(2);
  const AnalysedItem item = analysed("joint", record);
  ASSERT_EQ(item.results.front().verdict, Verdict::kNotUsable);
  const std::string text = shown(item);
  expect_first_screen(text, "not usable", "a.run");
  EXPECT_THAT(text, AllOf(Not(HasSubstr("+-")), HasSubstr("docs/troubleshooting.md")));
}

TEST_F(ResultSummaryTest, AnIncompleteRunSaysHowItIsContinued) {
  AnalysedItem item = analysed("joint");
  item.stored.header.plan.resize(120);
  item.stored.state = RunState::kInterrupted;
  const std::string text = shown(item);
  expect_first_screen(text, "usable", "a.run");
  EXPECT_THAT(text, AllOf(HasSubstr("interrupted: 0 of 120 angles"), HasSubstr("-> abcal resume a.run\n")));
}

TEST_F(ResultSummaryTest, OnlyADefaultThatCostsMoreThanATenthIsNamed) {
  EffectSizes sizes;
  for (const EffectSizeKey& key : effect_size_keys()) sizes.sources.emplace(key.key, "stated");
  sizes.sources.erase("alignment_deg");  // Some uncertainties of the matrix consist of it.
  sizes.sources.erase("hysteresis");
  const AnalysedItem item = analysed("joint", record_of(sizes));
  const Budget budget = make_budget(item.stored.record, item.results.front());
  const std::vector<DefaultCost> costs = default_costs(sizes, budget);
  ASSERT_EQ(costs.size(), 2U);
  EXPECT_EQ(costs[0].size->key, "alignment_deg");
  EXPECT_GT(costs[0].cost, kNotableCost);
  EXPECT_LT(costs[1].cost, kNotableCost);
  const std::string full = full_text(item, "a.run", stdout);
  EXPECT_THAT(full, AllOf(HasSubstr("alignment_deg"), HasSubstr("[item_uncertainty] hysteresis")));
  const std::string warnings = full.substr(full.find("Warnings\n"));
  EXPECT_THAT(warnings, AllOf(HasSubstr("[stage_uncertainty] alignment_deg"), Not(HasSubstr("hysteresis"))));
  // The first screen counts the warnings, those that the command lists.
  const auto listed = std::ranges::count_if(lines_of_text(warnings),
                                            [](const std::string& line) { return line.starts_with("  - "); });
  EXPECT_THAT(shown(item), HasSubstr(fmt::format("{} warning", listed)));
}

// The cost is what the definition says: U without this part of the variance.
TEST_F(ResultSummaryTest, TheCostOfADefaultIsWhatUWouldLoseWithoutItsPartOfTheVariance) {
  Budget budget;
  BudgetLine of_default, other;
  of_default.key = "wobble_urad";
  of_default.contribution.setConstant(3.0);
  other.contribution.setConstant(4.0);
  other.contribution(4) = 1.0;  // s_vy
  budget.lines = {of_default, other};
  budget.combined = (of_default.contribution.cwiseAbs2() + other.contribution.cwiseAbs2()).cwiseSqrt();
  EffectSizes sizes;
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.key != "wobble_urad") sizes.sources.emplace(key.key, "stated");
  const std::vector<DefaultCost> costs = default_costs(sizes, budget);
  ASSERT_EQ(costs.size(), 1U);
  EXPECT_EQ(costs[0].output, "s_vy");
  EXPECT_DOUBLE_EQ(costs[0].cost, 1.0 - 1.0 / std::sqrt(10.0));
}

// With the published estimator, whose weights do not depend on the size, the cost is exact.
TEST_F(ResultSummaryTest, OfThePublishedEstimatorTheCostIsTheChangeOfUWhenTheSizeBecomesZero) {
  const AnalysedItem item = analysed("abc");
  const std::vector<DefaultCost> costs =
      default_costs(item.stored.record.tolerances, make_budget(item.stored.record, item.results.front()));
  const auto alignment =
      std::ranges::find_if(costs, [](const DefaultCost& each) { return each.size->key == "alignment_deg"; });
  ASSERT_NE(alignment, costs.end());
  RunRecord without = item.stored.record;
  without.tolerances.alignment = Angle::degrees(0.0);
  const CalibrationResult result = analyse(without, "abc");
  double largest = 0.0;
  const std::vector<NamedQuantity> before = outputs(item.results.front()), after = outputs(result);
  for (std::size_t i = 0; i < before.size(); ++i) {
    const double smaller =
        1.0 - after[i].quantity.standard_uncertainty / before[i].quantity.standard_uncertainty;
    largest = std::max(largest, smaller);
    if (before[i].name == alignment->output) {
      EXPECT_NEAR(alignment->cost, smaller, 1e-3);
    }
  }
  EXPECT_NEAR(alignment->cost, largest, 1e-3);  // The correction for k2 and k3 changes a little.
}

TEST_F(ResultSummaryTest, SeveralItemsAreOneShortBlockEach) {
  const test::MadeTray tray = test::made_tray({.items = 3, .steps = 24, .mixed_mounting = false}, 21);
  std::vector<StoredRun> stored(3);
  for (int k = 1; k <= 3; ++k) {
    StoredRun& each = stored[static_cast<std::size_t>(k) - 1];
    each.record = tray.records[static_cast<std::size_t>(k) - 1];
    each.item = k;
    each.items.resize(3);
    each.header.items.resize(3);
    for (int i = 1; i <= 3; ++i) {
      each.header.items[static_cast<std::size_t>(i) - 1].k = i;
      each.header.items[static_cast<std::size_t>(i) - 1].serial_number = std::string(90, 's');
    }
  }
  const AnalysedRun run = analyse_run(std::move(stored), "joint");
  const std::string text = summary_text(run, "tray.run", stdout);
  std::string verdict(to_string(run.joint.verdict));
  std::ranges::replace(verdict, '_', ' ');
  expect_first_screen(text, verdict, "tray.run");
  for (const char* words : {"Item 1: ", "Item 2: ", "Item 3: ", "abcal analyse tray.run --item 3 --full"})
    EXPECT_THAT(text, HasSubstr(words));
}

}  // namespace
}  // namespace abcal
