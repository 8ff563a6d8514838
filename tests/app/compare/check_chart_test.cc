// Charts of check standards: baselines that are frozen, and later points judged by them.
#include "app/laboratory/compare/check_chart.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <random>

#include "app/laboratory/compare/chart_report.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr double kScatter = 1e-5;  // g, from run to run

/// A sound run of one item on one bench: every property scatters by kScatter.
class CheckChartTest : public testing::Test {
 protected:
  CheckRun run(const std::string& date, double shift_of_offset_u = 0.0) {
    CheckRun made;
    made.file = date + ".run";
    made.sha256 = sha256_of(made.file);
    made.date = date;
    made.maker = "Maker";
    made.model = "M-3";
    made.serial_number = "SN-42";
    made.bench = {"Stage 118001234", "bench 1"};
    made.estimator = "joint";
    made.response_unit = "g";
    for (Eigen::Index i = 0; i < 9; ++i)
      made.values(i) = (i < 3 ? 1.0 : i < 6 ? 90.0 : 0.01) + kScatter * normal_(engine_);
    made.values(6) += shift_of_offset_u;
    return made;
  }
  std::vector<CheckRun> runs(int count) {
    std::vector<CheckRun> made;
    for (int k = 1; k <= count; ++k) made.push_back(run("2026-01-" + std::to_string(10 + k)));
    return made;
  }
  static std::string refusal(const std::function<void()>& call) {
    try {
      call();
    } catch (const CheckChartError& error) {
      return error.what();
    }
    return {};
  }
  std::mt19937_64 engine_{20260301};
  std::normal_distribution<double> normal_;
};

// The limits are made once: they depend on the number of runs only.
TEST_F(CheckChartTest, AShiftAtPoint8Of12IsFlaggedFromThereOnAndNotBefore) {
  CheckBaseline baseline = make_baseline(runs(10), kUsualRunLength);
  EXPECT_EQ(baseline.demand.baseline_runs, 10);
  constexpr int kCharts = 200;
  int falsely = 0, missed = 0;
  for (int chart = 0; chart < kCharts; ++chart) {
    const std::vector<CheckRun> sound = runs(10);
    baseline.centre.setZero();
    IntrinsicValues squares = IntrinsicValues::Zero();
    for (const CheckRun& one : sound) baseline.centre += one.values / 10.0;
    for (const CheckRun& one : sound) squares += (one.values - baseline.centre).cwiseAbs2();
    baseline.standard_deviation = (squares / 9.0).cwiseSqrt();
    std::vector<ChartValue> points;
    for (int k = 1; k <= 12; ++k) points.push_back({run("2026-02", k >= 8 ? 1e-4 : 0.0).values, false});
    const std::vector<JudgedPoint> judged = judge_points(baseline, points);
    for (std::size_t k = 0; k < 12; ++k) {
      const bool outside = !outside_words(judged[k]).empty();
      if (k < 7) falsely += outside ? 1 : 0;
      if (k >= 7) missed += outside ? 0 : 1;
    }
  }
  // 1400 sound points at one false alarm in 200 or fewer, for nine baselines of ten.
  EXPECT_LE(falsely, 1400 / 200 + 3 * 3);
  // Ten standard deviations: each point of 1000 is beyond limits of less than eight, but for a baseline in a
  // thousand whose standard deviation came out twice too large.
  EXPECT_LT(baseline.rules.shewhart, 8.0);
  EXPECT_LE(missed, 5);
}

TEST_F(CheckChartTest, OneChartWithItsWords) {
  const CheckBaseline baseline = make_baseline(runs(10), kUsualRunLength);
  std::vector<ChartValue> points;
  for (int k = 1; k <= 12; ++k) points.push_back({run("2026-02", k >= 8 ? 1e-4 : 0.0).values, false});
  const std::vector<JudgedPoint> judged = judge_points(baseline, points);
  for (std::size_t k = 0; k < 7; ++k) EXPECT_EQ(outside_words(judged[k]), "") << k + 1;
  for (std::size_t k = 7; k < 12; ++k) {
    EXPECT_THAT(outside_words(judged[k]), AllOf(HasSubstr("O_u +"), HasSubstr("single value"))) << k + 1;
  }
  // After a lifted block the average and the sums restart: a repaired bench is inside at once.
  points.push_back({run("2026-03").values, true});
  EXPECT_EQ(outside_words(judge_points(baseline, points).back()), "");
  points.back().begins_anew = false;
  EXPECT_THAT(outside_words(judge_points(baseline, points).back()), HasSubstr("cumulative sum"));
}

TEST_F(CheckChartTest, ABaselineIsReadBackBitForBit) {
  const CheckBaseline baseline = make_baseline(runs(6), kUsualRunLength);
  const CheckBaseline again = baseline_from_json(baseline_json(baseline));
  EXPECT_EQ(again.centre, baseline.centre);
  EXPECT_EQ(again.standard_deviation, baseline.standard_deviation);
  EXPECT_EQ(again.rules.cusum, baseline.rules.cusum);
  EXPECT_EQ(again.first().bench.stage, "Stage 118001234");
  EXPECT_EQ(baseline_json(again), baseline_json(baseline));
  EXPECT_EQ(values_from_json(values_json(baseline.centre)), baseline.centre);
  EXPECT_THAT(refusal([] { baseline_from_json("{}"); }), HasSubstr("schema"));
  EXPECT_THAT(refusal([] { baseline_from_json("no JSON"); }), HasSubstr("cannot be read"));
}

TEST_F(CheckChartTest, ABaselineIsOfSoundRunsThatBelongTogether) {
  std::vector<CheckRun> few = runs(4);
  few[1].estimator = "abc";
  few[2].bench.stage = "Stage 9";
  few[3].sha256 = few[0].sha256;
  few[3].doubtful = "residuals";
  EXPECT_THAT(
      refusal([&] { make_baseline(few, kUsualRunLength); }),
      AllOf(HasSubstr("4 runs; a baseline needs at least 5"), HasSubstr("estimator abc; required: joint"),
            HasSubstr("stage Stage 9; required: Stage 118001234"), HasSubstr("stands twice"),
            HasSubstr("is doubtful: residuals")));
  std::vector<CheckRun> outlier = runs(12);
  outlier[5].values(6) += 2e-4;
  EXPECT_THAT(refusal([&] { make_baseline(outlier, kUsualRunLength); }),
              AllOf(HasSubstr("2026-01-16.run: O_u is"), HasSubstr("Grubbs")));
  std::vector<CheckRun> still = runs(6);
  for (CheckRun& one : still) one.values(3) = 90.0;
  EXPECT_THAT(refusal([&] { make_baseline(still, kUsualRunLength); }),
              HasSubstr("phi_uv: does not scatter at all"));
}

TEST_F(CheckChartTest, APointIsALaterRunOfTheSameItemOnTheSameBench) {
  const CheckBaseline baseline = make_baseline(runs(5), kUsualRunLength);
  EXPECT_EQ(against_point(baseline, run("2026-02-01"), "2026-01-15"), "");
  EXPECT_THAT(against_point(baseline, baseline.runs[2], "2026-01-01"), HasSubstr("is a run of the baseline"));
  CheckRun other = run("2026-01-01");
  other.serial_number = "SN-43";
  other.response_unit = "V";
  EXPECT_THAT(against_point(baseline, other, "2026-01-15"),
              AllOf(HasSubstr("item Maker M-3 SN-43; required: Maker M-3 SN-42"),
                    HasSubstr("response unit V; required: g"), HasSubstr("in the order of their time")));
}

TEST_F(CheckChartTest, ShowsItselfAsTextJsonAndPicture) {
  ShownChart chart;
  chart.name = "SN-42 2026";
  chart.approved_by = "Approver N. N.";
  chart.baseline = make_baseline(runs(5), kUsualRunLength);
  ShownChart::Point point{"SN-42 2026/1", "hash", "2026-02-01", "O_u +40.0", "Operator N. N.", true, {}};
  point.value.values = run("2026-02-01", 4e-4).values;
  chart.points.push_back(point);
  chart.blocks.push_back({"O_u +40.0", "2026-02-01T12:00:00Z", {}, {}, {}, true});
  EXPECT_THAT(
      chart_text(chart, stdout),
      AllOf(HasSubstr("OUTSIDE"), HasSubstr("abcal lab chart lift SN-42 2026"),
            HasSubstr("at most one in 200 check runs on average for nine baselines of ten of 5 runs")));
  const nlohmann::ordered_json json = chart_json(chart);
  EXPECT_EQ(json["schema"], "abcal.chart/1");
  EXPECT_TRUE(json["blocked"]);
  EXPECT_TRUE(json["points"][0]["properties"]["O_u"]["outside"]);
  EXPECT_GT(json["points"][0]["properties"]["O_u"]["z"].get<double>(), 10.0);
  EXPECT_THAT(chart_script(chart), AllOf(HasSubstr("set multiplot layout 3,3"), HasSubstr("$outside6")));
}

}  // namespace
}  // namespace abcal
