#include "app/studies/robustness/robustness_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <utility>

#include "app/results/analysis/analyses.h"
#include "app/studies/trials/parallel_trials.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/planned_dwell.h"

namespace abcal {
namespace {

constexpr std::size_t kOutputs = 18;  // s row by row, O, intrinsic s, phi
constexpr double kPauseS = 1.0;       // between two motions to an angle
constexpr double kNominal = 0.95;     // coverage probability of the intervals

/// Errors and stated uncertainties of one result.
struct RunOutcome {
  Verdict verdict = Verdict::kNotUsable;
  std::array<double, kOutputs> error{}, u{}, half_width{};
};

/// Which group an output belongs to.
std::size_t group_of(std::size_t output) {
  if (output < 9) return output % 4 == 0 ? 0 : 1;
  return output / 3 - 1;
}

void add_output(RunOutcome& outcome, std::size_t output, const Quantity& found, double truth) {
  outcome.error[output] = found.value - truth;
  outcome.u[output] = found.standard_uncertainty;
  outcome.half_width[output] = coverage_factor(found, kNominal) * found.standard_uncertainty;
}

RunOutcome outcome_of(const CalibrationResult& result, const sim::TrueLineResponse& truth) {
  RunOutcome outcome;
  if (!result.sensitivity_matrix || result.verdict == Verdict::kNotUsable) return outcome;
  outcome.verdict = result.verdict;
  const IntrinsicProperties intrinsic = intrinsic_properties(truth.sensitivity_matrix);
  for (std::size_t j = 0; j < 3; ++j) {
    const auto row = static_cast<Eigen::Index>(j);
    for (std::size_t k = 0; k < 3; ++k) {
      add_output(outcome, 3 * j + k, (*result.sensitivity_matrix)[j][k],
                 truth.sensitivity_matrix(row, static_cast<Eigen::Index>(k)));
    }
    add_output(outcome, 9 + j, result.offset[j], truth.offset[row]);
    add_output(outcome, 12 + j, result.intrinsic_sensitivity[j], intrinsic.sensitivity[row]);
    add_output(outcome, 15 + j, result.intrinsic_angle[j], intrinsic.angle_deg[row]);
  }
  return outcome;
}

/// Runs are summed in their order, whichever thread computed them.
ScenarioOutcome summed(const Scenario& scenario, const std::string& estimator,
                       const std::vector<const RunOutcome*>& runs) {
  ScenarioOutcome sum;
  sum.scenario = scenario.name;
  sum.words = scenario.words;
  sum.estimator = estimator;
  sum.kind = scenario.kind;
  std::array<double, kOutputGroups> covered{}, error2{}, u2{}, count{};
  std::array<double, kOutputs> u2_of_output{};
  for (const RunOutcome* run : runs) {
    ++sum.runs;
    sum.doubtful += run->verdict == Verdict::kDoubtful ? 1 : 0;
    sum.not_usable += run->verdict == Verdict::kNotUsable ? 1 : 0;
    if (run->verdict != Verdict::kUsable) continue;
    ++sum.usable;
    for (std::size_t i = 0; i < kOutputs; ++i) {
      const std::size_t group = group_of(i);
      covered[group] += std::abs(run->error[i]) <= run->half_width[i] ? 1.0 : 0.0;
      error2[group] += run->error[i] * run->error[i];
      u2[group] += run->u[i] * run->u[i];
      u2_of_output[i] += run->u[i] * run->u[i];
      count[group] += 1.0;
    }
  }
  for (std::size_t g = 0; g < kOutputGroups && sum.usable > 0; ++g)
    sum.groups[g] = {covered[g] / count[g], std::sqrt(error2[g] / count[g]), std::sqrt(u2[g] / count[g])};
  for (std::size_t i = 0; i < kOutputs && sum.usable > 0; ++i)
    sum.rms_u_of_output.push_back(std::sqrt(u2_of_output[i] / sum.usable));
  return sum;
}

std::vector<const Scenario*> chosen(const RobustnessOptions& options) {
  std::vector<const Scenario*> list;
  const std::vector<Scenario>& all = robustness_scenarios();
  for (const std::string& name : options.scenarios) {
    const auto found =
        std::find_if(all.begin(), all.end(), [&](const Scenario& s) { return s.name == name; });
    if (found == all.end()) {
      std::string names;
      for (const Scenario& s : all) names += (names.empty() ? "" : ", ") + s.name;
      throw std::invalid_argument(fmt::format("no scenario \"{}\"; there are: {}", name, names));
    }
    list.push_back(&*found);
  }
  if (list.empty()) {
    for (const Scenario& s : all) list.push_back(&s);
  }
  return list;
}

}  // namespace

const std::array<std::string, kOutputGroups>& output_group_names() {
  static const std::array<std::string, kOutputGroups> names{"s diagonal", "s off-diagonal", "O",
                                                            "intrinsic s", "phi"};
  return names;
}

std::vector<std::string> ScenarioOutcome::shortfalls() const {
  std::vector<std::string> list;
  if (kind == ScenarioKind::kWithin && usable_share() < kLeastUsable)
    list.push_back(fmt::format("usable {:.2f}, required {:.2f}", usable_share(), kLeastUsable));
  if (kind == ScenarioKind::kWrong && usable_share() > kMostUsableWhenWrong)
    list.push_back(fmt::format("usable {:.2f}, at most {:.2f} may be", usable_share(), kMostUsableWhenWrong));
  // A few usable runs do not show the coverage of their intervals.
  if (usable_share() <= kMostUsableWhenWrong) return list;
  for (std::size_t g = 0; g < kOutputGroups; ++g) {
    if (!(groups[g].coverage >= kLeastCoverage))
      list.push_back(fmt::format("{} {:.2f}", output_group_names()[g], groups[g].coverage));
  }
  return list;
}

SimulatedRun simulate_run(const ScenarioBench& bench) {
  SimulatedRun run;
  RunRecord& record = run.record;
  record.source = "robustness study";
  record.tolerances = bench.stated;
  record.steps = bench.steps;
  record.step = Angle::degrees(360.0 / bench.steps);
  record.expected.nominal_sensitivity = bench.scale;
  record.expected.sensitivity_tolerance = 1.0;
  ProtocolConfig protocol;
  protocol.steps = bench.steps;
  protocol.step = record.step;
  protocol.faces = bench.faces;
  record.axes_order = AxesOrder::kXThenZ;
  record.approach = protocol.approach;
  protocol.check_poses = false;  // A violated assumption must show in the experiments themselves.
  const std::vector<PlannedAngle> plan = make_rotation_plan(protocol, {});

  sim::SimBench world(bench.truth);
  run.truth = {Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const PlannedAngle& angle = plan[i];
    DwellRecord dwell = planned_dwell(angle);
    dwell.time_s = static_cast<double>(i) * bench.angle_period_s;
    const Clock::Instant t = world.start() + from_seconds(*dwell.time_s);
    // As in a run: X, then Z, each from below. The run begins at the present position of the stage.
    const double pause_s = i == 0 ? 0.0 : kPauseS;
    Clock::Instant at = t - from_seconds(4.0 * pause_s);
    for (const auto& [axis, to] : {std::pair(StageAxis::kX, angle.x), {StageAxis::kZ, angle.z}}) {
      if (to < world.commanded_angle(axis, at)) world.place(axis, to - protocol.approach, at);
      at += from_seconds(pause_s);
      world.place(axis, to, at);
      at += from_seconds(pause_s);
    }
    dwell.mean = world.output(t, i).value;
    if (bench.stated_noise > 0.0) dwell.u_mean = Eigen::Vector3d::Constant(bench.stated_noise);
    record.dwells.push_back(dwell);
    const sim::TrueLineResponse line = world.true_line_response(t);
    run.truth.sensitivity_matrix += line.sensitivity_matrix;
    run.truth.offset += line.offset;
  }
  run.truth.sensitivity_matrix /= static_cast<double>(plan.size());
  run.truth.offset /= static_cast<double>(plan.size());
  return run;
}

RobustnessStudy run_robustness_study(const RobustnessOptions& options) {
  if (options.benches < 1) throw std::invalid_argument("robustness study: at least 1 bench is required");
  if (options.threads < 1) throw std::invalid_argument("robustness study: at least 1 thread is required");
  const std::vector<const Scenario*> scenarios = chosen(options);
  const auto benches = static_cast<std::size_t>(options.benches);
  const std::size_t estimators = options.estimators.size();
  std::vector<const Estimator*> all;
  for (const std::string& name : options.estimators) all.push_back(&find_estimator(name));
  std::vector<RunOutcome> runs(scenarios.size() * benches * estimators);
  const std::size_t done = each_in_parallel(
      scenarios.size() * benches, {options.threads, options.stop, options.progress}, [&](std::size_t i) {
        const SimulatedRun run = simulate_run(draw_bench(*scenarios[i / benches], options.seed, i % benches));
        const std::vector<CalibrationResult> results = analyse(run.record, all);
        for (std::size_t e = 0; e < estimators; ++e)
          runs[i * estimators + e] = outcome_of(results[e], run.truth);
      });

  RobustnessStudy study;
  study.benches = options.benches;
  study.seed = options.seed;
  study.interrupted = done < scenarios.size() * benches;
  for (std::size_t s = 0; s < scenarios.size(); ++s) {
    if ((s + 1) * benches > done) break;  // of an interrupted study, whole scenarios only
    for (std::size_t e = 0; e < estimators; ++e) {
      std::vector<const RunOutcome*> own;
      for (std::size_t b = 0; b < benches; ++b) own.push_back(&runs[(s * benches + b) * estimators + e]);
      study.outcomes.push_back(summed(*scenarios[s], options.estimators[e], own));
    }
  }
  return study;
}

}  // namespace abcal
