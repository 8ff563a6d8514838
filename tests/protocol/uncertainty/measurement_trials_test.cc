// Monte Carlo of a common fit: each trial is a truth that runs and items share, with its readings, solved in
// full.

#include "protocol/uncertainty/measurement_trials.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "protocol/estimators/joint/analyse_tray.h"
#include "protocol/estimators/measurement/stage_learning.h"
#include "protocol/uncertainty/run_uncertainty.h"
#include "tests/protocol/estimators/made_tray.h"

namespace abcal {
namespace {

/// Tolerance for the ratio of a standard deviation over n trials to its expectation: 3.3 times 1 / sqrt(2 n),
/// and 5 % for shapes that are not normal and solutions that are not linear.
double tolerance(int trials) {
  return 3.3 / std::sqrt(2.0 * trials) + 0.05;
}

/// Items of one run, or the same ones in two: the second has the readings of the first with other noise.
struct MadeRuns {
  explicit MadeRuns(int runs, std::size_t items = 2) {
    const test::MadeTray tray = test::made_tray({.items = items, .steps = 12, .mixed_mounting = false}, 3);
    int number = 0;
    for (int run = 0; run < runs; ++run)
      for (std::size_t k = 0; k < items; ++k) {
        RunRecord& record = records.emplace_back(tray.records[k]);
        record.source = "run " + std::to_string(run + 1);
        places.push_back({static_cast<int>(k), run});
        for (DwellRecord& dwell : record.dwells)
          for (Eigen::Index j = 0; j < 3 && run > 0; ++j)
            dwell.mean(j) += (*dwell.u_mean)(j)*std::sin(17.0 * ++number);
      }
  }
  std::vector<RunRecord> records;
  std::vector<ItemInRun> places;
};

RunUncertainty study_of(const MadeRuns& made, int item, const CalibrationResult& result, unsigned threads = 0,
                        std::uint64_t trials = 100) {
  UncertaintyOptions options;
  options.trials = trials;
  options.threads = threads;
  return common_fit_uncertainty({made.records, made.places, item}, result, options);
}

void expect_as_stated(const RunUncertainty& study) {
  const auto trials = static_cast<int>(study.combined.trials);
  for (int k = 0; k < kStudyOutputs; ++k) {
    const double stated = study.joint->standard_uncertainty(k);
    EXPECT_NEAR(study.combined.standard_deviation(k) / stated, 1.0, tolerance(trials)) << output_symbol(k);
    // A bias of the linear approximation would show in the mean: 3.7 standard errors.
    EXPECT_LT(std::abs(study.combined.mean(k)), 3.7 * stated / std::sqrt(1.0 * trials)) << output_symbol(k);
  }
}

TEST(MeasurementTrialsTest, ItemsOfOneRunScatterAsTheirCommonFitStates) {
  const MadeRuns made(1);
  const TrayResult tray = analyse_tray(made.records);
  ASSERT_TRUE(tray.items[1].in_common_fit);
  const RunUncertainty study = study_of(made, 1, tray.items[1].result, 0, 200);
  EXPECT_TRUE(study.no_trials.empty());
  EXPECT_EQ(study.combined.trials, 200U);
  expect_as_stated(study);
}

void expect_runs_scatter_as_stated(std::uint64_t trials) {
  const MadeRuns made(2);
  const SeriesRuns each = fit_each_run(made.records, made.places, {});
  const SeriesResult series = analyse_series(made.records, each, std::vector<int>{0, 1});
  expect_as_stated(study_of(made, 0, series.items[0], 0, trials));
}
TEST(MeasurementTrialsTest, ItemsInTwoRunsScatterAsTheirCommonFitStates) {
  expect_runs_scatter_as_stated(40);
}
TEST(LongMeasurementTrialsTest, ItemsInTwoRunsScatterAsTheirCommonFitStates) {
  expect_runs_scatter_as_stated(600);
}

TEST(MeasurementTrialsTest, AnItemWithARecordOfItsStageScattersAsStated) {
  MadeRuns taught(2);
  const SeriesRuns each = fit_each_run(taught.records, taught.places, {});
  auto record = std::make_shared<StageRecord>(learn_stage(each.runs, std::nullopt, 0.0).record);
  record->learnings.push_back({.utc = "2026-11-01T08:00:00Z", .by = {}, .runs = {}});
  MadeRuns made(1, 1);
  made.records.front().stage_record.record = record;
  const TrayResult result = analyse_tray(made.records);
  ASSERT_TRUE(result.items.front().result.stage_record);
  expect_as_stated(study_of(made, 0, result.items.front().result));
}

TEST(MeasurementTrialsTest, TrialsDependOnSeedAndNumberAlone) {
  const MadeRuns made(1);
  const TrayResult tray = analyse_tray(made.records);
  const RunUncertainty one = study_of(made, 0, tray.items[0].result, 1, 9);
  const RunUncertainty three = study_of(made, 0, tray.items[0].result, 3, 9);
  EXPECT_EQ(one.combined.standard_deviation, three.combined.standard_deviation);
  EXPECT_EQ(one.combined.mean, three.combined.mean);
}

// A bench that does nothing wrong gives no error: sizes of zero, readings of almost no noise.
TEST(MeasurementTrialsTest, WithoutErrorsATrialGivesItsTruth) {
  MadeRuns made(2, 1);
  EffectSizes none;
  for (const EffectSizeKey& key : effect_size_keys()) key.set(none, 0.0);
  for (RunRecord& record : made.records) record.tolerances = none;
  JointOptions white;  // The mean of a process would be part of the offset of the fit.
  white.noise_process = false;
  const SeriesRuns each = fit_each_run(made.records, made.places, white);
  const MeasurementTruths truths(each.runs);
  const MeasurementTruth truth = truths.draw([](const std::string&) { return 1.0; });
  for (std::size_t m = 0; m < truth.in_runs.size(); ++m) {
    const Eigen::VectorXd& fitted = truths.fit().in_runs[m].value;
    EXPECT_LT((truth.in_runs[m] - fitted).cwiseAbs().maxCoeff(), 1e-12) << "run " << m;
  }
  EXPECT_LT((truth.lines.front() - truths.fit().items.front().line).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(MeasurementTrialsTest, ATruthSharesTheStageBetweenItemsAndTheItemBetweenRuns) {
  const MadeRuns made(2);
  const SeriesRuns each = fit_each_run(made.records, made.places, {});
  const MeasurementTruths truths(each.runs);
  double next = 0.0;
  const MeasurementTruth truth = truths.draw([&](const std::string&) { return std::sin(++next); });
  const EffectLayout& layout = each.information.front().layout;
  const auto of_stage = [&](std::size_t m) {
    return truth.in_runs[m].segment(layout.first_stage(), layout.first_sweep() - layout.first_stage());
  };
  EXPECT_EQ(of_stage(0), of_stage(1)) << "two items in one run";
  EXPECT_NE(of_stage(0), of_stage(2)) << "zeros and floor differ from run to run";
  for (std::size_t i = 0; i < layout.stage.size(); ++i) {
    const EffectUnknown& unknown =
        each.information.front().unknowns[static_cast<std::size_t>(layout.first_stage()) + i];
    const auto at = static_cast<Eigen::Index>(i);
    if (repeat_part_of(unknown.name) >= 0) continue;
    EXPECT_EQ(of_stage(0)(at), of_stage(2)(at)) << unknown.name << " is of the stage in every run";
  }
  for (std::size_t i = 0; i < layout.own.size(); ++i) {
    const Eigen::Index at = EffectLayout::kOwnFixed + static_cast<Eigen::Index>(i);
    const bool drifts = layout.own[i].effect->kind == ItemEffectKind::kDrift;
    EXPECT_NE(truth.in_runs[0](at), truth.in_runs[1](at)) << "two items";
    EXPECT_EQ(truth.in_runs[0](at) == truth.in_runs[2](at), !drifts) << layout.own[i].effect->key;
  }
}

}  // namespace
}  // namespace abcal
