#include "protocol/estimators/series/series_result.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <set>
#include <string>
#include <utility>

#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/joint/joint_verdict.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

RunRecord with_sizes_of_record(const RunRecord& record) {
  RunRecord out = record;
  out.tolerances = sizes_with_record(record.tolerances);
  return out;
}

Message words_of_contradiction(const EffectTest& test) {
  return {
      "{effect} is {times:.1f} times as far from the record as it expects (probability {probability:.1g})",
      test.name, test.times_stated, test.probability};
}

StageRecordUse use_of(const StageRecord& record, double age_months, std::vector<EffectTest> tests) {
  StageRecordUse out{.stage = fmt::format("{} {}, serial number {}", record.identity.maker,
                                          record.identity.model, record.identity.serial_number),
                     .learned_utc = record.learned_utc(),
                     .runs = record.runs(),
                     .age_months = age_months,
                     .validity_months = validity_months(record),
                     .sha256 = record.sha256,
                     .tests = std::move(tests)};
  for (const EffectTest& test : out.tests) out.agrees = out.agrees && test.passed;
  return out;
}

/// Reports which record was used, and objects if the run contradicts it.
void report_record(const StageRecordUse& use, const Message& furthest, CalibrationResult& result) {
  result.diagnostics.notes.push_back(
      Message("the record of the stage is used: {stage}, learned {date} from {runs} runs, {age:.1f} months "
              "before this run "
              "(SHA-256 {hash})",
              use.stage, use.learned_utc.substr(0, 10), use.runs, use.age_months,
              use.sha256.empty() ? Message("not known") : Message("{hash}", use.sha256.substr(0, 16))));
  if (use.age_months > use.validity_months)
    result.diagnostics.notes.push_back(Message(
        "the record of the stage is older than its validity of {months:.1f} months; what may have changed "
        "since is in the uncertainties",
        use.validity_months));
  if (use.agrees) return;
  std::vector<Message> words;
  for (const EffectTest& test : use.tests)
    if (!test.passed) words.push_back(words_of_contradiction(test));
  object_to(
      result,
      Message("this run contradicts the record of its stage: {tests}; furthest from it: {furthest}; learn "
              "the stage again, or analyse without the record",
              words, furthest));
}

}  // namespace

EffectSizes sizes_with_record(EffectSizes sizes) {
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.section == "stage_uncertainty") sizes.sources.emplace(key.key, "record of the stage");
  return sizes;
}

CalibrationResult result_with_record(const RunRecord& record, const ItemFit& own) {
  const StageRecord& stage = *record.stage_record.record;
  if (!own.solution) return joint_result(record, own);
  const FitWithRecord with = fit_with_record(own.data, *own.solution, stage, record.stage_record.age_months);
  if (!with.converged) {
    CalibrationResult result = joint_result(record, own);
    object_to(result,
              Message("the fit with the record of the stage did not converge; this result is without it"));
    return result;
  }
  CalibrationResult result = joint_result(with_sizes_of_record(record), own, &with.fit);
  result.stage_record = use_of(stage, record.stage_record.age_months, with.tests);
  report_record(*result.stage_record, Message("{what}", with.largest), result);
  return result;
}

SeriesRuns fit_each_run(std::span<const RunRecord> records, std::span<const int> items,
                        const JointOptions& options) {
  SeriesRuns out;
  std::vector<Eigen::Vector3d> units;
  for (std::size_t k = 0; k < records.size(); ++k) {
    JointOptions of_run = options;
    of_run.measured_alignment = records[k].measured_alignment;
    const auto item = static_cast<std::size_t>(items[k]);
    if (item < units.size()) of_run.unit = units[item];
    out.own.push_back(std::make_unique<ItemFit>(fit_item(records[k], of_run)));
    const ItemFit& own = *out.own.back();
    if (!own.solution) throw UnusableData(Message("{run}: {why}", records[k].source, own.why));
    if (item == units.size()) units.push_back(own.solution->fit.unit);
    out.alone.push_back(joint_result(records[k], own));
    out.information.push_back(run_information(own.data, *own.solution));
    out.information.back().source = records[k].source;
  }
  for (std::size_t k = 0; k < records.size(); ++k) out.runs.push_back({&out.information[k], items[k]});
  return out;
}

CalibrationResult analyse_series(std::span<const RunRecord> records, const JointOptions& options) {
  constexpr double kDegrees = 180.0 / std::numbers::pi;
  const std::vector<int> items(records.size(), 0);
  const SeriesRuns each = fit_each_run(records, items, options);
  const RunRecord& first = records.front();
  const StageRecordInUse& stage = first.stage_record;
  SeriesOptions series_options;
  if (stage.record) series_options = with_record(*stage.record, stage.age_months);
  const SeriesFit series = fit_series(each.runs, series_options);
  if (!series.converged)
    throw UnusableData(
        "the common fit of these runs did not converge: they are not runs of one item on one stage");

  const EffectFit common = common_fit(each.own.front()->solution->fit, each.information.front(), series);
  CalibrationResult result =
      joint_result(stage.record ? with_sizes_of_record(first) : first, *each.own.front(), &common);
  result.source.clear();
  std::set<std::string> mountings;
  for (std::size_t k = 0; k < records.size(); ++k) {
    const SeriesRunResult& run = series.runs[k];
    SeriesMember member{records[k].source, run.mounting(), {}, each.alone[k].verdict};
    for (std::size_t i = 0; i < 3; ++i)
      member.small_turn_deg[i] = run.small_turn(static_cast<Eigen::Index>(i)) * kDegrees;
    mountings.insert(member.mounting);
    result.source += (k == 0 ? "" : ", ") + records[k].source;
    result.series.push_back(std::move(member));
    if (k > 0 && each.alone[k].verdict != Verdict::kUsable)
      object_to(result, Message("{run} alone: {why}", records[k].source, each.alone[k].why));
  }
  result.diagnostics.notes.push_back(
      mountings.size() == 1
          ? Message("one fit of {runs} runs in 1 mounting; the sensitivity matrix is that of the mounting of "
                    "{run}",
                    records.size(), first.source)
          : Message(
                "one fit of {runs} runs in {count} mountings; the sensitivity matrix is that of the mounting "
                "of {run}",
                records.size(), mountings.size(), first.source));
  const double probability = chi2_tail(series.chi2, series.degrees_of_freedom);
  if (probability < kFamilyWiseFalseAlarm)
    object_to(result, Message("the runs contradict each other: see that they are of one item on one stage"));
  if (stage.record) {
    std::vector<EffectTest> tests = test_state(each.information.front(), series.runs.front(),
                                               *series_options.stage, stage.record->repeatabilities);
    judge_record(tests);
    result.stage_record = use_of(*stage.record, stage.age_months, std::move(tests));
    report_record(*result.stage_record, Message("its first run"), result);
  }
  return result;
}

}  // namespace abcal
