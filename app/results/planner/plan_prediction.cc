#include "app/results/planner/plan_prediction.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

#include "app/bench_file/level_file.h"
#include "app/results/analysis/analyses.h"
#include "protocol/record/planned_dwell.h"
#include "sim/sim_bench.h"

namespace abcal {
namespace {

/// Readings of the item on an ideal stage, in g_loc.
RunRecord ideal_record(const PlanningBench& bench, const ProtocolConfig& protocol,
                       const std::vector<PlannedAngle>& plan, const PlanDuration& duration,
                       std::uint64_t seed) {
  const BenchConfig& config = bench.config;
  RunRecord record;
  record.source = "plan";
  record.tolerances = config.items.front().tolerances;
  record.estimator = protocol.estimator;
  record.steps = protocol.steps;
  record.step = protocol.step;
  record.expected.nominal_sensitivity = 1.0;
  record.expected.sensitivity_tolerance = 1.0;
  if (!config.stage.level_file.empty())
    record.measured_alignment = read_level_file(config.stage.level_file).alignment;
  const int readings = readings_per_dwell(protocol, config.items.front().accelerometer.settings.rate_hz);
  const double u = bench.item.noise / std::sqrt(readings);
  const double angle_s = duration.total_s() / static_cast<double>(plan.size());
  sim::BenchTruth truth;
  truth.seed = seed;
  truth.noise = u;
  truth.sensitivity_matrix = bench.item.sensitivity_matrix;
  truth.offset = bench.item.offset;
  sim::SimBench world(truth);
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const PlannedAngle& angle = plan[i];
    DwellRecord dwell = planned_dwell(angle);
    dwell.count = readings;
    dwell.time_s = static_cast<double>(i) * angle_s;
    const Clock::Instant t = world.start() + from_seconds(*dwell.time_s);
    world.place(StageAxis::kX, angle.x, t);
    world.place(StageAxis::kZ, angle.z, t);
    dwell.mean = world.output(t, i).value;
    dwell.u_mean = Eigen::Vector3d::Constant(u);
    if (!angle.check) {
      record.dwells.push_back(std::move(dwell));
    } else {
      record.check_poses.push_back({std::move(dwell), record.dwells.size()});
    }
  }
  return record;
}

/// The outputs of a group, in the order of OutputVector.
std::vector<int> outputs_of_group(PlannedOutput group) {
  switch (group) {
    case PlannedOutput::kSensitivity:
      return {0, 4, 8};
    case PlannedOutput::kOffDiagonal:
      return {1, 2, 3, 5, 6, 7};
    case PlannedOutput::kOffset:
      return {kFirstOffset, kFirstOffset + 1, kFirstOffset + 2};
    case PlannedOutput::kAngle:
      return {kFirstIntrinsicAngle, kFirstIntrinsicAngle + 1, kFirstIntrinsicAngle + 2};
  }
  return {};
}

/// The stated uncertainty depends on the noise that the estimator finds in its readings, so predictions are
/// means over this number of runs.
constexpr std::uint64_t kRuns = 3;

Budget predicted_budget(const PlanningBench& bench, const ProtocolConfig& protocol,
                        const std::vector<PlannedAngle>& plan, const PlanDuration& duration,
                        std::uint64_t seed) {
  const RunRecord record = ideal_record(bench, protocol, plan, duration, seed);
  const CalibrationResult result = analyse(record, protocol.estimator);
  if (!result.sensitivity_matrix) {
    throw std::invalid_argument(fmt::format(
        "the {} estimator gives no sensitivity matrix from {} angles on this bench: {}; required: "
        "[protocol] estimator = \"joint\" or \"abc\", and sizes of the effects that leave every output "
        "determined",
        protocol.estimator, circles_and_angles(protocol), result.why));
  }
  return make_budget(record, result);
}

LargestPart largest_part(const Budget& budget, int output) {
  LargestPart largest;
  for (const BudgetLine& line : budget.lines) {
    const double share = budget.share(line, output);
    if (share > largest.share) largest = {line.input, share};
  }
  return largest;
}

}  // namespace

std::string circles_and_angles(const ProtocolConfig& protocol) {
  return fmt::format("{} x {}", 3 * protocol.faces, protocol.steps / protocol.faces);
}

Eigen::Matrix3d usual_directions() {
  Eigen::Matrix3d rows;
  rows << 1.0, 4e-3, -6e-3,  //
      -5e-3, 1.0, 7e-3,      //
      6e-3, -8e-3, 1.0;
  return rows.rowwise().normalized();
}

PlanPrediction predict_plan(const PlanningBench& bench, const ProtocolConfig& protocol) {
  PlanPrediction prediction;
  prediction.protocol = protocol;
  const std::vector<PlannedAngle> plan = make_rotation_plan(protocol, bench.travel);
  prediction.duration = estimate_duration(plan, protocol, bench.speed,
                                          bench.config.items.front().accelerometer.settings.rate_hz);
  OutputVector variance = OutputVector::Zero();
  std::vector<Budget> budgets;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    budgets.push_back(predicted_budget(bench, protocol, plan, prediction.duration, seed));
    variance += budgets.back().combined.cwiseAbs2() / static_cast<double>(kRuns);
  }
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    int worst = -1;
    for (const int output : outputs_of_group(static_cast<PlannedOutput>(group))) {
      if (worst < 0 || variance[output] > variance[worst]) worst = output;
    }
    prediction.u[group] = std::sqrt(variance[worst]);
    prediction.limits[group] = largest_part(budgets.front(), worst);
  }
  return prediction;
}

Budget predict_budget(const PlanningBench& bench, const ProtocolConfig& protocol) {
  const std::vector<PlannedAngle> plan = make_rotation_plan(protocol, bench.travel);
  const PlanDuration duration = estimate_duration(plan, protocol, bench.speed,
                                                  bench.config.items.front().accelerometer.settings.rate_hz);
  return predicted_budget(bench, protocol, plan, duration, 1);
}

}  // namespace abcal
