#include "app/results/analysis/analyses.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "app/results/analysis/agreement.h"
#include "app/results/analysis/effect_words.h"
#include "app/results/analysis/stage_record_use.h"
#include "protocol/estimators/checks/result_checks.h"
#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/plan/backlash.h"
#include "protocol/quantities/output_names.h"
#include "protocol/quantities/quantity_groups.h"
#include "sim/sim_bench.h"

namespace abcal {

namespace {

CalibrationResult refused(const RunRecord& record, const std::string& estimator, const Message& why) {
  CalibrationResult result;
  result.estimator = estimator;
  result.source = record.source;
  result.response_unit = record.response_unit;
  result.verdict = Verdict::kNotUsable;
  result.why = why;
  return result;
}

/// A refusal of the record is a result; every other exception is a fault of the program.
CalibrationResult estimate(const RunRecord& record, const Estimator& estimator) {
  try {
    return estimator.fit(record);
  } catch (const UnusableData& error) {
    return refused(record, estimator.name, error.message());
  }
}

/// Times of the run's angles since its start, in seconds; empty unless every angle has one.
std::vector<double> times_of(const RunRecord& record) {
  std::vector<double> times;
  for (const DwellRecord& dwell : record.dwells)
    if (dwell.time_s && std::isfinite(*dwell.time_s)) times.push_back(*dwell.time_s);
  if (times.size() < record.dwells.size()) times.clear();
  return times;
}

/// The line response of a simulated item, averaged over the times of the run's angles. Without times it is
/// averaged over the bench's span; quantities that change without limit (drift_per_hour, the room's
/// temperature) then have their initial values, because the duration of the run is not known.
sim::TrueLineResponse mean_line_response(sim::ItemTruth truth, const sim::StageTruth& stage,
                                         std::vector<double> times) {
  if (times.empty()) {
    constexpr int kTimes = 101;
    truth.drift_per_hour.setZero();
    truth.temperature_per_hour = 0.0;
    for (int k = 0; k < kTimes; ++k) times.push_back(stage.span_s * k / (kTimes - 1));
  }
  const sim::SimBench world(truth, stage, {});
  const auto count = static_cast<double>(times.size());
  sim::TrueLineResponse mean{Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
  for (const double time_s : times) {
    const sim::TrueLineResponse at = world.true_line_response(world.start() + from_seconds(time_s));
    mean.sensitivity_matrix += at.sensitivity_matrix / count;
    mean.offset += at.offset / count;
  }
  return mean;
}

/// Adds the checks and notes that concern the run as a whole.
void add_checks(const RunRecord& record, const std::vector<Check>& of_the_record, CalibrationResult& result) {
  const auto times = [](int n) { return n == 1 ? Message("once") : Message("{count} times", n); };
  apply_checks(of_the_record, record, result);
  const EffectSizes sizes = result.stage_record ? sizes_with_record(record.tolerances) : record.tolerances;
  if (Message words = default_effects_words(sizes, Advice::kNone); !words.empty())
    result.diagnostics.notes.push_back(std::move(words));
  for (Message& words : uncovered_effects_words(sizes, Advice::kNone))
    result.diagnostics.notes.push_back(std::move(words));
  if (backlash_is_left(record) && find_estimator(result.estimator).needs_angles)
    result.diagnostics.notes.push_back(backlash_words(record.tolerances.zero));
  if (record.order_assumed && result.verdict != Verdict::kNotUsable) {
    constexpr Term kOrder{
        "the file has no time_s: the order of its rows is taken as the order of time, on which drift, "
        "hysteresis and slow noise depend. If it is another, the uncertainties are too small. Add time_s, or "
        "the line \"# row_order: time\""};
    result.diagnostics.notes.push_back(kOrder);
    result.why = in_sequence({result.why, kOrder});
  }
  if (record.continuations > 0) {
    result.diagnostics.notes.push_back(
        Message("the run was interrupted and resumed {times}; each time the axes were homed again, and the "
                "repeated last angle agreed",
                times(record.continuations)));
  }
  if (record.reconnections > 0) {
    result.diagnostics.notes.push_back(Message(
        "the port of an instrument vanished and came back {times}; each time an instrument of the same model "
        "answered, with the same serial number where it has one, and the repeated last angle agreed",
        times(record.reconnections)));
  }
}

/// Checks the sizes that another estimator rests on: the joint fit of the same readings may contradict them.
Check sizes_check(const CalibrationResult& joint) {
  const std::vector<Message>& contradicted = joint.joint->contradicted_sizes;
  Check check{"stated sizes of effects",
              static_cast<double>(contradicted.size()),
              0.0,
              "contradicted",
              contradicted.empty(),
              {}};
  if (!check.passed) check.words = Message("the joint fit contradicts what is stated: {sizes}", contradicted);
  return check;
}

}  // namespace

void require_angles(const RunRecord& record, const Estimator& estimator) {
  if (!estimator.needs_angles || has_angles(record) || record.read_as.empty()) return;
  throw std::invalid_argument(fmt::format(
      "{}: the {} estimator needs angles, and the table has none; required: --estimator norm (the "
      "default for this table), or the columns experiment, n and alpha_deg",
      record.source, estimator.name));
}

RunAnalysis analyse_items(std::span<const RunRecord> records,
                          const std::vector<const Estimator*>& estimators) {
  for (const Estimator* estimator : estimators) require_angles(records.front(), *estimator);
  RunAnalysis analysis;
  const bool needs_joint = std::ranges::any_of(estimators, [](const Estimator* estimator) {
    return estimator->fit == nullptr || estimator->rests_on_stated_sizes;
  });
  if (needs_joint) {
    JointOptions options;
    options.measured_alignment = records.front().measured_alignment;  // All share the stage.
    analysis.joint = analyse_tray(records, options);
  }
  for (std::size_t k = 0; k < records.size(); ++k) {
    const RunRecord& record = records[k];
    // Without angles there is no motion in which to look for slips and missed steps.
    const std::vector<Check> of_the_record = needs_joint          ? analysis.joint.items[k].checks
                                             : has_angles(record) ? check_record(record)
                                                                  : std::vector<Check>();
    const CalibrationResult* joint = nullptr;
    if (needs_joint) {
      add_checks(record, of_the_record, analysis.joint.items[k].result);
      joint = &analysis.joint.items[k].result;
    }
    // The verdict on the joint result does not depend on what else was asked for.
    const Estimator& other = find_estimator(kPublishedEstimator);
    std::optional<CalibrationResult> beside;
    if (needs_joint && joint->verdict != Verdict::kNotUsable && has_angles(record)) {
      beside = estimate(record, other);
      if (beside->verdict != Verdict::kNotUsable)
        object_to_disagreement(apart(*beside, *joint), "", analysis.joint.items[k].result);
    }
    std::vector<CalibrationResult>& results = analysis.results.emplace_back();
    for (const Estimator* estimator : estimators) {
      if (estimator->fit == nullptr) {
        results.push_back(*joint);
        continue;
      }
      std::vector<Check> checks = of_the_record;
      if (estimator->rests_on_stated_sizes && joint->joint) checks.push_back(sizes_check(*joint));
      results.push_back(estimator == &other && beside ? *beside : estimate(record, *estimator));
      add_checks(record, checks, results.back());
    }
  }
  if (needs_joint) judge_tray(analysis.joint);
  return analysis;
}

std::vector<CalibrationResult> analyse(const RunRecord& record,
                                       const std::vector<const Estimator*>& estimators) {
  return std::move(analyse_items({&record, 1}, estimators).results.front());
}

CalibrationResult analyse(const RunRecord& record, const Estimator& estimator) {
  return std::move(analyse(record, std::vector{&estimator}).front());
}

CalibrationResult analyse(const RunRecord& record, const std::string& estimator) {
  return analyse(record, find_estimator(estimator));
}

std::vector<const Estimator*> all_estimators(const RunRecord& record) {
  const Estimator& declared = declared_estimator(record);
  std::vector<const Estimator*> in_order{&declared};
  for (const Estimator& estimator : estimators()) {
    if (&estimator != &declared && (has_angles(record) || !estimator.needs_angles))
      in_order.push_back(&estimator);
  }
  return in_order;
}

std::vector<CalibrationResult> analyse_all(const RunRecord& record) {
  return analyse(record, all_estimators(record));
}

const CalibrationResult& AnalysedItem::result() const {
  return results.size() == 1 ? results.front() : result_of(results, declared_estimator(stored.record).name);
}

AnalysedRun analyse_run(std::vector<StoredRun> items, const std::string& estimator) {
  std::vector<RunRecord> records;
  for (StoredRun& item : items) {
    use_stored_stage_record(item);
    records.push_back(item.record);
  }
  RunAnalysis analysis = analyse_items(
      records, estimator.empty() ? all_estimators(records.front()) : std::vector{&find_estimator(estimator)});
  AnalysedRun run;
  run.joint = std::move(analysis.joint);
  for (std::size_t k = 0; k < items.size(); ++k)
    run.items.push_back({std::move(items[k]), std::move(analysis.results[k])});
  return run;
}

TruthComparison compare_with_truth(const CalibrationResult& result, const RunRecord& record,
                                   const BenchConfig& bench, int item) {
  const sim::TrueLineResponse line =
      mean_line_response(item_truth(bench, item), bench.simulation, times_of(record));
  const Eigen::Matrix3d& s = line.sensitivity_matrix;
  const IntrinsicProperties intrinsic = intrinsic_properties(s);
  TruthComparison comparison;
  comparison.text = fmt::format("  {:<8} {:>14} {:>14} {:>12} {:>12}\n", "quantity", "truth", "result",
                                "difference", "/ std. unc.");
  const auto add = [&](const std::string& name, double truth, const Quantity& q) {
    if (std::isnan(q.value) && !find_estimator(result.estimator).certifiable) return;
    const double ratio = (q.value - truth) / q.standard_uncertainty;
    // A result that is not a number agrees with nothing.
    comparison.largest = std::max(
        comparison.largest, std::isfinite(ratio) ? std::abs(ratio) : std::numeric_limits<double>::infinity());
    comparison.text += fmt::format("  {:<8} {:>14.7f} {:>14.7f} {:>+12.2e} {:>+12.2f}\n", name, truth,
                                   q.value, q.value - truth, ratio);
  };
  const Eigen::Matrix3d columns = s.transpose();  // Column by column: s row by row.
  std::vector<double> truths(columns.data(), columns.data() + columns.size());
  for (const Eigen::Vector3d& three : {intrinsic.sensitivity, intrinsic.angle_deg, line.offset})
    truths.insert(truths.end(), three.begin(), three.end());
  const std::vector<NamedQuantity> found = outputs(result);
  for (std::size_t i = result.sensitivity_matrix ? 0 : kOfMatrix; i < truths.size(); ++i)
    add(found[i].name, truths[i], found[i].quantity);
  comparison.text +=
      fmt::format("  largest difference: {:.2f} standard uncertainties; at most {} allowed: {}\n",
                  comparison.largest, comparison.allowed, comparison.agrees() ? "agrees" : "DISAGREES");
  return comparison;
}

}  // namespace abcal
