#include "app/studies/stage_records/stage_record_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <utility>

#include "app/studies/constant_rate/constant_rate_study.h"
#include "app/studies/robustness/robustness_study.h"
#include "app/studies/trials/measured_run.h"
#include "app/studies/trials/parallel_trials.h"
#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/measurement/stage_learning.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/mountings.h"
#include "sim/drawn_stage.h"

namespace abcal {
namespace {

struct Design {
  StageExperiment experiment;
  std::string_view words;
  std::array<double, kStageGroups> limit;
};
constexpr std::array<Design, kStageExperiments> kDesigns{
    Design{StageExperiment::kTwoFaces, "two faces 6 x 36", {4.5e-6, 3.5e-5, 4.5e-5, 2.8e-4}},
    Design{StageExperiment::kTwoMountings, "2 mountings x two faces 6 x 18", {4.2e-6, 7.5e-6, 0.0, 1.8e-4}},
    Design{StageExperiment::kSixMountings, "6 mountings x 3 x 12", {4.5e-6, 9.0e-6, 0.0, 1.6e-4}},
    Design{StageExperiment::kTwelveMountings,
           "12 mountings x 3 x 24, repeatable stage",
           {2.0e-6, 1e-6, 8e-6, 8e-5}},
    Design{StageExperiment::kWithRecord, "new item, 3 x 24, with the record", {5.0e-6, 4.5e-6, 8e-6, 4.0e-4}},
    Design{StageExperiment::kTwoMountingsWithRecord,
           "new item, 2 mountings x two faces 6 x 18, with the record",
           {2.6e-6, 2.0e-6, 8e-6, 1.6e-4}},
    Design{StageExperiment::kYearLater, "new item, 3 x 24, a year after the learning", {}},
    Design{StageExperiment::kTwoMountingsAtRate,
           "2 mountings at 60 and 20 degrees/s, 90 s each",
           {5.0e-6, 1.0e-5, 0.0, 2.5e-4}},
    Design{StageExperiment::kTwoThatDiffer,
           "2 mountings x two faces 6 x 18, item that changes from run to run",
           {}},
    Design{StageExperiment::kAtRateWithRecord,
           "new item, 60 and 20 degrees/s, 90 s, with the record",
           {6.0e-6, 1.0e-5, 1.2e-5, 4.0e-4}},
    Design{StageExperiment::kTrayAtRateWithRecord,
           "tray of 8 new items, 60 and 20 degrees/s, with the record",
           {6.0e-6, 1.0e-5, 1.2e-5, 4.0e-4}},
};

bool is_at_rate(StageExperiment experiment) {
  return experiment == StageExperiment::kTwoMountingsAtRate ||
         experiment == StageExperiment::kAtRateWithRecord ||
         experiment == StageExperiment::kTrayAtRateWithRecord;
}

/// A run with its truth, as the fit of a series takes it.
struct RunOfSeries {
  RunInformation information;
  std::optional<sim::TrueLineResponse> truth;  ///< Without drift, in the mounting of this run.
  double zero = 0.0;                           ///< Mean error of X over the angles of the frame (radian).
};

/// Angles over which the mean error of X defines the frame of the stage: at 0 degrees the axis has its own
/// zero, at -90 degrees the error of the initial turn.
bool is_of_frame(const AxisAngle& visit) {
  return visit.axis == 'X' && visit.microdegrees != 0 && visit.microdegrees != 270'000'000;
}

/// A stage with two items in the order in which they are measured.
class Trial {
 public:
  Trial(std::uint64_t seed, std::uint64_t stage, bool repeats)
      : stage_(2 * stage + (repeats ? 1U : 0U)), draw_(seed, 0x57A6E0000U + (repeats ? 1U : 0U), stage) {
    const std::vector<Scenario>& all = robustness_scenarios();
    everything_ = &*std::ranges::find(all, "everything", &Scenario::name);
    bench_ = draw_bench(*everything_, seed, stage + (repeats ? 1'000'000'000U : 0U));
    for (sim::AxisTruth* axis : {&bench_.truth.x, &bench_.truth.z}) {
      const Angle steps = std::exchange(axis->step_error_sd, Angle());
      axis->fine_map_sd = repeats ? steps : Angle();
      axis->step_repeatability_sd = repeats ? Angle::degrees(0.0005) : steps;
      axis->homing_repeatability_sd = Angle::degrees(repeats ? 0.001 : 0.0);
    }
    bench_.truth.floor_repeatability_urad = repeats ? 5.0 : 0.0;
  }

  /// Time passes, and each value of the fine map changes by 0.0002 degrees times the root of it.
  void wait(double months) {
    bench_.truth.age_months = months;
    bench_.truth.x.growth_sd = bench_.truth.z.growth_sd = Angle::degrees(0.0002);
  }
  /// Each value of the fine map changes by five times the repeatability of a step.
  void knock() {
    bench_.truth.knock_from_run = run_ + 1;
    bench_.truth.x.knock_sd = bench_.truth.z.knock_sd = Angle::degrees(0.0025);
  }

  /// The item changes from run to run, by what is stated.
  void change_from_run_to_run() { bench_.stated.drift_between_runs = 1e-5; }

  /// Another item takes the place of that before.
  void new_item() {
    ScenarioBench other = bench_;
    everything_->change(other, draw_);
    static_cast<sim::OutputTruth&>(bench_.truth) = other.truth;
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k)
        bench_.truth.sensitivity_matrix(j, k) = (j == k ? 1.0 : 0.0) + 0.02 * draw_.normal();
    bench_.truth.offset = draw_.normals(0.02);
    unit_.reset();
    runs_of_item_ = 0;
  }

  /// @param turn  how the item is mounted, as mounting_turns() has it
  RunOfSeries measure(int faces, int steps, const Eigen::Matrix3d& turn) {
    ScenarioBench b = bench_;
    b.faces = faces;
    b.steps = steps;
    b.truth.stands_in_second_face = faces == 2;
    b.truth.span_s = (3 * (steps + faces) - 1) * b.angle_period_s;
    mount(turn, b);
    return evaluated(simulate_run(b).record, b.truth);
  }

  /// At 60 and 20 degrees/s: this item, and new ones beside it.
  std::vector<RunOfSeries> measure_at_rate(const Eigen::Matrix3d& turn, int items = 1) {
    StudyBench bench;
    std::vector<sim::BenchTruth> truths;
    const std::uint64_t run = run_;
    for (int k = 0; k < items; ++k) {
      if (k > 0) new_item();
      run_ = run;
      ScenarioBench b = bench_;
      turn_at_60_and_20(b.truth, b.stated, bench.protocol, draw_);
      mount(turn, b);
      if (k == 0) bench.stage = b.truth;
      // The errors of the stage in motion are those that were drawn with the first item.
      static_cast<sim::StageTruth&>(b.truth) = bench.stage;
      bench.items.push_back({.truth = b.truth, .sizes = b.stated, .reading_hz = kReadingHzAt60And20});
      truths.push_back(b.truth);
    }
    constexpr std::uint64_t kMostRuns = 1000;
    const MeasuredRecords measured = measure_bench(bench, stage_ * kMostRuns + run_);
    std::vector<RunOfSeries> out;
    for (std::size_t k = 0; k < truths.size(); ++k) {
      if (items > 1) unit_.reset();
      out.push_back(evaluated(measured.items[k], truths[k]));
    }
    return out;
  }

 private:
  /// The item as it stands in the next run, with the drifts of that run.
  void mount(const Eigen::Matrix3d& turn, ScenarioBench& b) {
    constexpr double kMounting = 0.5 * std::numbers::pi / 180.0;
    const EffectSizes& sizes = b.stated;
    b.truth.run = ++run_;
    const Eigen::Vector3d small =
        runs_of_item_++ > 0 ? draw_.normals(kMounting) : Eigen::Vector3d(Eigen::Vector3d::Zero());
    b.truth.sensitivity_matrix = bench_.truth.sensitivity_matrix * sim::turned_by(small) * turn.transpose();
    changed_ = {Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
    if (sizes.drift_between_runs > 0.0) {
      changed_.sensitivity_matrix << draw_.normals(sizes.drift_between_runs),
          draw_.normals(sizes.drift_between_runs), draw_.normals(sizes.drift_between_runs);
      changed_.offset = draw_.normals(sizes.drift_between_runs);
      b.truth.sensitivity_matrix += changed_.sensitivity_matrix;
      b.truth.offset += changed_.offset;
    }
    b.truth.drift_1 = draw_.normals(sizes.drift);
    b.truth.drift_2 = draw_.normals(sizes.drift);
    b.truth.drift_3 = draw_.normals(sizes.drift);
    b.truth.sensitivity_drift = draw_.normals(sizes.sensitivity_drift);
  }

  RunOfSeries evaluated(const RunRecord& record, const sim::BenchTruth& truth) {
    const ItemFit fit = fit_item(record, {.noise_process = false, .measured_alignment = {}, .unit = unit_});
    if (!fit.solution) throw std::runtime_error("study of stage records: a run has no result: " + fit.why);
    RunOfSeries out{.information = run_information(fit.data, *fit.solution, RunNoise::kMean), .truth = {}};
    unit_ = out.information.unit;
    set_truth(truth, fit.data, out);
    // The measurand is the item in the mean.
    out.truth->sensitivity_matrix -= changed_.sensitivity_matrix;
    out.truth->offset -= changed_.offset;
    return out;
  }

  static void set_truth(const sim::BenchTruth& truth, const CollectedReadings& data, RunOfSeries& out) {
    sim::BenchTruth still = truth;
    still.drift_1 = still.drift_2 = still.drift_3 = still.sensitivity_drift = Eigen::Vector3d::Zero();
    const sim::SimBench world(still);
    out.truth = world.true_line_response(world.start());
    const sim::DrawnStage stage(truth);
    double count = 0.0;
    for (std::size_t n = 0; n < data.dwells.size(); ++n) {
      if (!is_of_frame(out.information.visits[n])) continue;
      const DwellRecord& dwell = *data.dwells[n];
      out.zero += stage.error(StageAxis::kX, dwell.commanded_x, dwell.commanded_z).rad();
      count += 1.0;
    }
    out.zero /= count;
  }

  std::uint64_t stage_ = 0;
  ScenarioDraw draw_;
  const Scenario* everything_ = nullptr;
  ScenarioBench bench_;
  std::uint64_t run_ = 0;
  int runs_of_item_ = 0;
  std::optional<Eigen::Vector3d> unit_;
  /// Difference of the item in this run from the item in the mean.
  sim::TrueLineResponse changed_{Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
};

/// Errors and standard uncertainties of one experiment on one stage, group by group.
struct TrialOutcome {
  bool solved = false;
  std::array<ErrorsAndU, kStageGroups> error_and_u;
  void add(std::size_t group, double error, double variance) {
    error_and_u[group].emplace_back(error, std::sqrt(variance));
  }
};

/// s_vz and s_wy of the first run, turned about X by its mean error, in which the stage has its own zero.
void add_frame(const RunOfSeries& first, const InRunFit& found, TrialOutcome& out) {
  const EffectLayout& layout = first.information.layout;
  Eigen::RowVectorXd zero = Eigen::RowVectorXd::Zero(found.value.size());
  double count = 0.0;
  for (std::size_t n = 0; n < first.information.visits.size(); ++n) {
    if (!is_of_frame(first.information.visits[n])) continue;
    zero(layout.count() + static_cast<Eigen::Index>(n)) = 1.0;
    const SinCos angle = sincos(Angle::degrees(first.information.visits[n].degrees()));
    const StagePose pose = StagePose::of(1, 1, angle.sin, angle.cos);
    for (std::size_t i = 0; i < layout.stage.size(); ++i) {
      const StageShare share = layout.stage[i].effect->share(pose, layout.stage[i].index);
      if (share.input == kInputAngleX)
        zero(layout.first_stage() + static_cast<Eigen::Index>(i)) += share.value;
    }
    count += 1.0;
  }
  zero /= count;
  const double found_zero = zero.dot(found.value);
  const Vector12 line = line_values(layout, found.value);
  const Rows12 line_by = line_rows(layout, found.value);
  struct Element {
    int output, of, other;
    double sign;
  };
  for (const Element& e : {Element{1, 2, 1, 1.0}, Element{2, 1, 2, -1.0}}) {
    const double size = first.information.unit(e.output);
    const Eigen::Matrix3d& truth = first.truth->sensitivity_matrix;
    const double right = (truth(e.output, e.of) + e.sign * truth(e.output, e.other) * first.zero) / size;
    const double other = line(3 * e.output + e.other);
    Eigen::RowVectorXd row = e.sign * other * zero;
    row.head(layout.count()) +=
        line_by.row(3 * e.output + e.of) + e.sign * found_zero * line_by.row(3 * e.output + e.other);
    const double value = line(3 * e.output + e.of) + e.sign * other * found_zero;
    out.add(2, value - right, (row * found.covariance * row.transpose()).value());
  }
}

void add_item(const RunOfSeries& first, const FittedItem& item, TrialOutcome& out) {
  Eigen::Matrix3d s;
  for (int j = 0; j < 3; ++j) s.row(j) = item.line.segment<3>(3 * j).transpose();
  const IntrinsicProperties found = intrinsic_properties(s);
  const IntrinsicProperties truth = intrinsic_properties(first.truth->sensitivity_matrix);
  const Covariance9 covariance =
      intrinsic_jacobian(s) * item.covariance_line * intrinsic_jacobian(s).transpose();
  for (Eigen::Index j = 0; j < 3; ++j) {
    out.add(0, found.sensitivity(j) - truth.sensitivity(j), covariance(j, j));
    out.add(1, item.line(9 + j) - first.truth->offset(j), item.covariance_line(9 + j, 9 + j));
    out.add(3, found.angle_deg(j) - truth.angle_deg(j), covariance(3 + j, 3 + j));
  }
}

struct Series {
  std::vector<RunOfSeries> runs;
  MeasurementFit fit;
};

Series fitted(std::vector<RunOfSeries> measured, const MeasurementOptions& options) {
  Series out{.runs = std::move(measured), .fit = {}};
  std::vector<MeasuredItem> runs;
  for (const RunOfSeries& run : out.runs)
    runs.push_back({.information = &run.information, .run = static_cast<int>(runs.size()), .pose = {}});
  out.fit = fit_measurement(runs, options);
  return out;
}

Series measure(Trial& trial, int faces, int steps, const std::vector<Eigen::Matrix3d>& turns,
               const MeasurementOptions& options = {}) {
  std::vector<RunOfSeries> runs;
  for (const Eigen::Matrix3d& turn : turns) runs.push_back(trial.measure(faces, steps, turn));
  return fitted(std::move(runs), options);
}

Series measure_at_rate(Trial& trial, const std::vector<Eigen::Matrix3d>& turns,
                       const MeasurementOptions& options = {}) {
  std::vector<RunOfSeries> runs;
  for (const Eigen::Matrix3d& turn : turns) runs.push_back(std::move(trial.measure_at_rate(turn).front()));
  return fitted(std::move(runs), options);
}

TrialOutcome outcome_of(const Series& series, bool with_frame) {
  TrialOutcome out;
  out.solved = series.fit.converged;
  if (!out.solved) return out;
  for (const FittedItem& item : series.fit.items) {
    add_item(series.runs[item.first], item, out);
    if (with_frame) add_frame(series.runs[item.first], series.fit.in_runs[item.first], out);
  }
  return out;
}

struct TrialOutcomes {
  std::array<TrialOutcome, kStageExperiments> of{};
  RecordAlarms alarms;
};

/// Whether the first run of a series contradicts the record that was its prior.
bool contradicts(const Series& series, const MeasurementOptions& with_record) {
  if (!series.fit.converged) return true;
  std::vector<EffectTest> tests = test_state(series.runs.front().information, series.fit.in_runs.front(),
                                             *with_record.stage, *with_record.repeatabilities);
  judge_record(tests);
  return std::ranges::any_of(tests, [](const EffectTest& test) { return !test.passed; });
}

TrialOutcomes run_trial(std::uint64_t seed, std::uint64_t stage, bool at_rate) {
  TrialOutcomes out;
  const auto at = [&](StageExperiment experiment) -> TrialOutcome& {
    return out.of[static_cast<std::size_t>(experiment)];
  };
  const Eigen::Matrix3d as_is = Eigen::Matrix3d::Identity();
  {
    Trial trial(seed, stage, false);
    at(StageExperiment::kTwoFaces) = outcome_of(measure(trial, 2, 72, {as_is}), true);
    trial.new_item();
    at(StageExperiment::kTwoMountings) = outcome_of(measure(trial, 2, 36, mounting_turns(2)), false);
    trial.new_item();
    at(StageExperiment::kSixMountings) = outcome_of(measure(trial, 1, 12, mounting_turns(6)), false);
    trial.new_item();
    if (at_rate)
      at(StageExperiment::kTwoMountingsAtRate) = outcome_of(measure_at_rate(trial, mounting_turns(2)), false);
    trial.new_item();
    trial.change_from_run_to_run();
    at(StageExperiment::kTwoThatDiffer) = outcome_of(measure(trial, 2, 36, mounting_turns(2)), false);
  }
  Trial trial(seed, stage, true);
  Series taught;
  std::vector<MeasuredItem> teaching;
  for (const Eigen::Matrix3d& turn : mounting_turns(12)) taught.runs.push_back(trial.measure(1, 24, turn));
  for (const RunOfSeries& run : taught.runs)
    teaching.push_back(
        {.information = &run.information, .run = static_cast<int>(teaching.size()), .pose = {}});
  StageLearned learned = learn_stage(teaching, std::nullopt, 0.0);
  taught.fit = std::move(learned.fit);
  at(StageExperiment::kTwelveMountings) = outcome_of(taught, true);
  if (!taught.fit.converged) return out;
  const MeasurementOptions record = with_record(learned.record, 0.0);
  trial.new_item();
  const Series sound = measure(trial, 1, 24, {as_is}, record);
  at(StageExperiment::kWithRecord) = outcome_of(sound, true);
  out.alarms.sound += 1;
  out.alarms.sound_contradicted += contradicts(sound, record) ? 1 : 0;
  trial.new_item();
  const Series two = measure(trial, 2, 36, mounting_turns(2), record);
  at(StageExperiment::kTwoMountingsWithRecord) = outcome_of(two, true);
  out.alarms.sound += 1;
  out.alarms.sound_contradicted += contradicts(two, record) ? 1 : 0;

  trial.new_item();
  if (at_rate) {
    const Series swept = measure_at_rate(trial, {as_is}, record);
    at(StageExperiment::kAtRateWithRecord) = outcome_of(swept, true);
    out.alarms.sound += 1;
    out.alarms.sound_contradicted += contradicts(swept, record) ? 1 : 0;
    constexpr int kItemsOfTray = 8;
    trial.new_item();
    TrialOutcome& tray = at(StageExperiment::kTrayAtRateWithRecord);
    tray.solved = true;
    for (RunOfSeries& item : trial.measure_at_rate(as_is, kItemsOfTray)) {
      std::vector<RunOfSeries> alone;
      alone.push_back(std::move(item));
      const TrialOutcome of_item = outcome_of(fitted(std::move(alone), record), true);
      tray.solved = tray.solved && of_item.solved;
      for (std::size_t g = 0; g < kStageGroups; ++g)
        tray.error_and_u[g].insert(tray.error_and_u[g].end(), of_item.error_and_u[g].begin(),
                                   of_item.error_and_u[g].end());
    }
  }

  Trial knocked = trial;
  knocked.knock();
  knocked.new_item();
  out.alarms.knocked += 1;
  out.alarms.knocked_contradicted += contradicts(measure(knocked, 1, 24, {as_is}, record), record) ? 1 : 0;
  Trial other(seed, stage + 500'000'000U, true);
  other.new_item();
  out.alarms.other += 1;
  out.alarms.other_contradicted += contradicts(measure(other, 1, 24, {as_is}, record), record) ? 1 : 0;

  constexpr double kYear = 12.0;
  trial.wait(kYear);
  trial.new_item();
  at(StageExperiment::kYearLater) =
      outcome_of(measure(trial, 1, 24, {as_is}, with_record(learned.record, kYear)), true);
  return out;
}

StageExperimentOutcome summed(const Design& design, const std::vector<const TrialOutcome*>& trials,
                              std::uint64_t seed) {
  StageExperimentOutcome out{.experiment = design.experiment,
                             .words = std::string(design.words),
                             .stages = static_cast<int>(trials.size()),
                             .groups = {}};
  for (const TrialOutcome* trial : trials) out.failed += trial->solved ? 0 : 1;
  for (std::size_t g = 0; g < kStageGroups; ++g) {
    std::vector<ErrorsAndU> of_group;
    for (const TrialOutcome* trial : trials) of_group.push_back(trial->error_and_u[g]);
    out.groups[g] = error_group(of_group, design.limit[g], seed + g);
  }
  return out;
}

}  // namespace

const std::array<std::string_view, kStageGroups>& stage_group_names() {
  static constexpr std::array<std::string_view, kStageGroups> kNames{"s", "O", "s_vz, s_wy", "phi"};
  return kNames;
}

std::vector<std::string> StageRecordStudy::contradictions() const {
  struct Test {
    double probability;
    std::string words;
  };
  std::vector<Test> tests;
  for (const StageExperimentOutcome& outcome : outcomes)
    for (std::size_t g = 0; g < kStageGroups; ++g)
      // The record expects more growth than these stages have.
      if (const bool may_be_small = outcome.experiment == StageExperiment::kYearLater;
          outcome.groups[g].rms_u > 0.0 && !(may_be_small && outcome.groups[g].rms_z < 1.0))
        tests.push_back(
            {outcome.groups[g].probability,
             fmt::format("{}, {}: rms z {:.3f} (probability {:.1g})", outcome.words, stage_group_names()[g],
                         outcome.groups[g].rms_z, outcome.groups[g].probability)});
  std::ranges::sort(tests, {}, &Test::probability);
  std::vector<std::string> out;
  for (std::size_t i = 0; i < tests.size(); ++i) {
    if (tests[i].probability > 0.05 / static_cast<double>(tests.size() - i)) break;
    out.push_back(tests[i].words);
  }
  return out;
}

std::vector<std::string> StageRecordStudy::missed() const {
  std::vector<std::string> out;
  // The figures of the design have two digits.
  const auto two_digits = [](double value) { return std::stod(fmt::format("{:.1e}", value)); };
  for (const StageExperimentOutcome& outcome : outcomes)
    for (std::size_t g = 0; g < kStageGroups; ++g)
      if (const ErrorGroup& group = outcome.groups[g];
          group.limit > 0.0 && two_digits(group.rms_u) > group.limit)
        out.push_back(fmt::format("{}, {}: u {:.2g}, figure {:.2g}", outcome.words, stage_group_names()[g],
                                  group.rms_u, group.limit));
  return out;
}

StageRecordStudy run_stage_record_study(const StageRecordOptions& options) {
  if (options.stages < 1) throw std::invalid_argument("study of stage records: at least 1 stage is required");
  if (options.threads < 1)
    throw std::invalid_argument("study of stage records: at least 1 thread is required");
  std::vector<TrialOutcomes> trials(static_cast<std::size_t>(options.stages));
  const std::size_t done = each_in_parallel(
      trials.size(), {options.threads, options.stop, options.progress, 1}, [&](std::size_t i) {
        trials[i] = run_trial(options.seed, i, i < static_cast<std::size_t>(options.stages_at_rate));
      });
  StageRecordStudy study;
  study.stages = static_cast<int>(done);
  study.seed = options.seed;
  study.interrupted = done < trials.size();
  for (std::size_t e = 0; e < kStageExperiments && done > 0; ++e) {
    std::vector<const TrialOutcome*> own;
    const bool at_rate = is_at_rate(kDesigns[e].experiment);
    const std::size_t stages =
        at_rate ? std::min(done, static_cast<std::size_t>(options.stages_at_rate)) : done;
    for (std::size_t i = 0; i < stages; ++i) own.push_back(&trials[i].of[e]);
    study.outcomes.push_back(summed(kDesigns[e], own, options.seed));
  }
  for (std::size_t i = 0; i < done; ++i) {
    const RecordAlarms& one = trials[i].alarms;
    study.alarms.sound += one.sound;
    study.alarms.sound_contradicted += one.sound_contradicted;
    study.alarms.knocked += one.knocked;
    study.alarms.knocked_contradicted += one.knocked_contradicted;
    study.alarms.other += one.other;
    study.alarms.other_contradicted += one.other_contradicted;
  }
  return study;
}

}  // namespace abcal
