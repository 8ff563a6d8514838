#include "protocol/estimators/measurement/measurement_result.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <set>
#include <string>
#include <utility>

#include "protocol/estimators/joint/joint_result.h"
#include "protocol/estimators/joint/joint_verdict.h"
#include "protocol/estimators/measurement/stage_poses.h"
#include "protocol/estimators/shared/objection.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/estimators/shared/voltmeter.h"
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
              "before this run (SHA-256 {hash})",
              use.stage, use.learned_utc.substr(0, 10), use.runs, use.age_months,
              use.sha256.empty() ? Message("not known") : Message("{hash}", use.sha256.substr(0, 16))));
  if (use.age_months > use.validity_months)
    result.diagnostics.notes.push_back(
        Message("the record of the stage is older than its validity of {months:.1f} months; what may have "
                "changed since is in the uncertainties",
                use.validity_months));
  if (use.agrees) return;
  std::vector<Message> words;
  for (const EffectTest& test : use.tests)
    if (!test.passed) words.push_back(words_of_contradiction(test));
  object_to(result, Message("this run contradicts the record of its stage: {tests}; furthest from it: "
                            "{furthest}; learn the stage again, or analyse without the record",
                            words, furthest));
}

/// The runs of one item in a fit.
struct RunsOfItem {
  std::span<const std::size_t> places;  ///< Place of each measured item among the records.
  std::span<const MeasuredItem> measured;
  const MeasurementFit& fit;
  int item;
};

/// States the runs of an item with their mountings, and what is to be known of them.
void add_runs(std::span<const RunRecord> records, const SeriesRuns& each, const RunsOfItem& of,
              CalibrationResult& result) {
  constexpr double kDegrees = 180.0 / std::numbers::pi;
  result.source.clear();
  std::set<std::string> mountings;
  std::string first;
  for (std::size_t m = 0; m < of.measured.size(); ++m) {
    if (of.measured[m].item != of.item) continue;
    const std::size_t k = of.places[m];
    const InRunFit& run = of.fit.in_runs[m];
    const std::string& source = records[k].source;
    if (first.empty()) first = source;
    SeriesMember member{source, run.mounting(), {}, each.alone[k].verdict, {}};
    for (std::size_t i = 0; i < 3; ++i)
      member.small_turn_deg[i] = run.small_turn(static_cast<Eigen::Index>(i)) * kDegrees;
    mountings.insert(member.mounting);
    result.source += (result.series.empty() ? "" : ", ") + source;
    if (!result.series.empty() && each.alone[k].verdict != Verdict::kUsable)
      object_to(result, Message("{run} alone: {why}", source, each.alone[k].why));
    result.series.push_back(std::move(member));
  }
  const std::size_t runs = result.series.size();
  result.diagnostics.notes.push_back(
      mountings.size() == 1
          ? Message("one fit of {runs} runs in 1 mounting; the sensitivity matrix is that of the mounting "
                    "of {run}",
                    runs, first)
          : Message("one fit of {runs} runs in {count} mountings; the sensitivity matrix is that of the "
                    "mounting of {run}",
                    runs, mountings.size(), first));
  if (runs > 1 && !(records.front().tolerances.drift_between_runs > 0.0))
    result.diagnostics.notes.push_back(Message(
        "the item is taken to be the same in all runs; where its offset or sensitivity changes from run "
        "to run, state by how much: [item_uncertainty] drift_between_runs"));
}

}  // namespace

EffectSizes sizes_with_record(EffectSizes sizes) {
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.section == "stage_uncertainty") sizes.sources.emplace(key.key, kStageRecordSource);
  return sizes;
}

CalibrationResult result_from(const RunRecord& record, const ItemFit& own, const MeasuredItem& first,
                              const MeasurementFit& fit, const MeasurementOptions& options) {
  const EffectFit common = common_fit(own.solution->fit, first, fit);
  const StageRecordInUse& stage = record.stage_record;
  if (!stage.record) return joint_result(record, own, &common);
  CalibrationResult result = joint_result(with_sizes_of_record(record), own, &common);
  std::string largest;
  const std::size_t at = fit.items[static_cast<std::size_t>(first.item)].first;
  result.stage_record = use_of(
      *stage.record, stage.age_months,
      test_run(*first.information, fit.in_runs[at], *options.stage, stage.record->repeatabilities, largest));
  report_record(*result.stage_record, Message("{what}", largest), result);
  return result;
}

CalibrationResult result_with_record(const RunRecord& record, const ItemFit& own) {
  if (!own.solution) return joint_result(record, own);
  const RunInformation information = run_information(own.data, *own.solution);
  const MeasurementOptions options = options_of(record.stage_record);
  const MeasuredItem item{.information = &information, .pose = {}, .own = &*own.solution};
  const MeasurementFit fit = fit_measurement({&item, 1}, options);
  if (fit.converged) return result_from(record, own, item, fit, options);
  CalibrationResult result = joint_result(record, own);
  object_to(result,
            Message("the fit with the record of the stage did not converge; this result is without it"));
  return result;
}

bool are_of_one_run(std::span<const ItemInRun> places) {
  return std::ranges::all_of(places, [&](const ItemInRun& place) { return place.run == places.front().run; });
}

SeriesRuns fit_each_run(std::span<const RunRecord> records, std::span<const ItemInRun> places,
                        const JointOptions& options) {
  SeriesRuns out;
  std::map<int, Eigen::Vector3d> units;
  const bool several = !are_of_one_run(places);
  for (std::size_t k = 0; k < records.size(); ++k) {
    JointOptions of_run = options;
    of_run.measured_alignment = records[k].measured_alignment;
    if (const auto unit = units.find(places[k].item); unit != units.end()) of_run.unit = unit->second;
    out.own.push_back(std::make_unique<ItemFit>(fit_item(records[k], of_run)));
    const ItemFit& own = *out.own.back();
    if (!own.solution) throw UnusableData(Message("{run}: {why}", records[k].source, own.why));
    units.try_emplace(places[k].item, own.solution->fit.unit);
    out.alone.push_back(joint_result(records[k], own));
    out.information.push_back(
        run_information(own.data, *own.solution, several ? RunNoise::kMean : RunNoise::kMostProbable));
    out.information.back().source = records[k].source;
  }
  for (std::size_t first = 0; first < records.size();) {
    std::size_t end = first;
    while (end < records.size() && places[end].run == places[first].run) ++end;
    const StagePoses poses(records.subspan(first, end - first));
    for (std::size_t k = first; k < end; ++k)
      out.runs.push_back({.information = &out.information[k],
                          .item = places[k].item,
                          .run = places[k].run,
                          .pose = poses.of(out.own[k]->data),
                          .own = several ? &*out.own[k]->solution : nullptr});
    first = end;
  }
  return out;
}

SeriesResult analyse_series(std::span<const RunRecord> records, const SeriesRuns& each,
                            std::span<const int> items) {
  std::vector<MeasuredItem> measured;
  std::vector<std::size_t> places;
  for (std::size_t k = 0; k < records.size(); ++k) {
    const auto found = std::ranges::find(items, each.runs[k].item);
    if (found == items.end()) continue;
    places.push_back(k);
    measured.push_back(each.runs[k]);
    measured.back().item = static_cast<int>(found - items.begin());
  }
  const MeasurementOptions options = options_of(records.front().stage_record);
  const MeasurementFit fit = fit_measurement(measured, options);
  if (!fit.converged)
    throw UnusableData(
        "the common fit of these runs did not converge: they are not runs of one item on one stage");
  SeriesResult out;
  out.covariance = fit.covariance_lines;
  out.runs_agree = chi2_tail(fit.chi2, fit.degrees_of_freedom) >= kFamilyWiseFalseAlarm;
  for (std::size_t i = 0; i < items.size(); ++i) {
    const std::size_t at = fit.items[i].first, first = places[at];
    CalibrationResult& result =
        out.items.emplace_back(result_from(records[first], *each.own[first], measured[at], fit, options));
    add_runs(records, each, {places, measured, fit, static_cast<int>(i)}, result);
    if (!out.runs_agree)
      object_to(result,
                Message("the runs contradict each other: see that they are of one item on one stage"));
  }
  std::vector<ReadItem> read;
  for (std::size_t i = 0; i < items.size(); ++i)
    read.push_back({&out.items[i], &records[places[fit.items[i].first]].tolerances});
  add_shared_voltmeters(read, out.covariance);
  return out;
}

}  // namespace abcal
