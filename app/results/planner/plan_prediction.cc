#include "app/results/planner/plan_prediction.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/bench_file/level_file.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/estimators.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/record/planned_dwell.h"
#include "sim/sim_bench.h"

namespace abcal {
namespace {

double reading_rate_hz(const PlanningBench& bench) {
  return bench.config.items.front().accelerometer.settings.rate_hz;
}

/// The noise of the means of an ideal record.
struct MeanNoise {
  double stated = 0.0;  ///< Standard deviation that each mean states.
  double drawn = 0.0;   ///< Standard deviation that it has; 0: no noise.
  std::uint64_t seed = 0;
  int readings = 1;  ///< Number of readings in each mean.
};

/// Readings of the item on an ideal stage, in g_loc.
/// @param angle_s  time from angle to angle
RunRecord ideal_record(const PlanningBench& bench, const ProtocolConfig& protocol,
                       const std::vector<PlannedAngle>& plan, double angle_s, const MeanNoise& noise) {
  const BenchConfig& config = bench.config;
  RunRecord record;
  record.source = "plan";
  record.tolerances = config.items.front().tolerances;
  record.estimator = protocol.estimator;
  record.steps = protocol.steps;
  record.step = protocol.step;
  record.stage_record = bench.stage_record;
  record.expected.nominal_sensitivity = 1.0;
  record.expected.sensitivity_tolerance = 1.0;
  if (!config.stage.level_file.empty())
    record.measured_alignment = read_level_file(config.stage.level_file).alignment;
  sim::BenchTruth truth;
  truth.seed = noise.seed;
  truth.noise = noise.drawn;
  truth.sensitivity_matrix = bench.item.sensitivity_matrix;
  truth.offset = bench.item.offset;
  sim::SimBench world(truth);
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const PlannedAngle& angle = plan[i];
    DwellRecord dwell = planned_dwell(angle);
    dwell.count = noise.readings;
    dwell.time_s = static_cast<double>(i) * angle_s;
    const Clock::Instant t = world.start() + from_seconds(*dwell.time_s);
    world.place(StageAxis::kX, angle.x, t);
    world.place(StageAxis::kZ, angle.z, t);
    dwell.mean = world.output(t, i).value;
    dwell.u_mean = Eigen::Vector3d::Constant(noise.stated);
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

[[noreturn]] void throw_no_matrix(const ProtocolConfig& protocol, const Message& why) {
  throw std::invalid_argument(fmt::format(
      "the {} estimator gives no sensitivity matrix from {} angles on this bench: {}; required: [protocol] "
      "estimator = \"joint\" or \"abc\", and sizes of the effects that leave every output determined",
      protocol.estimator, circles_and_angles(protocol), why));
}

Budget predicted_budget(const PlanningBench& bench, const ProtocolConfig& protocol,
                        const std::vector<PlannedAngle>& plan, const PlanDuration& duration, int run) {
  const int readings = readings_per_dwell(protocol, reading_rate_hz(bench));
  const double u = bench.item.noise / std::sqrt(readings);
  const RunRecord record =
      ideal_record(bench, protocol, plan, duration.total_s() / static_cast<double>(plan.size()),
                   {.stated = u, .drawn = u, .seed = static_cast<std::uint64_t>(run), .readings = readings});
  try {
    const Estimator& estimator = find_estimator(protocol.estimator);
    // ABC alone: whether the joint fit agrees with its sizes changes no uncertainty.
    const CalibrationResult result =
        estimator.fit != nullptr ? estimator.fit(record) : analyse(record, estimator);
    if (!result.sensitivity_matrix) throw_no_matrix(protocol, result.why);
    return make_budget(record, result);
  } catch (const UnusableData& error) {
    throw_no_matrix(protocol, error.message());
  }
}

/// Number of the worst output of a group.
int worst_output(PlannedOutput group, const OutputVector& variance) {
  const std::vector<int> outputs = outputs_of_group(group);
  return *std::ranges::max_element(outputs, {}, [&](int output) { return variance[output]; });
}

/// Variances of the outputs of a joint fit.
/// @param line, covariance  s row by row and O, without the voltmeter
OutputVector variances(const Vector12& line, Covariance12 covariance, const EffectSizes& sizes) {
  const Eigen::Matrix3d s = line.head<9>().reshaped<Eigen::RowMajor>(3, 3);
  const VoltmeterShare voltmeter = voltmeter_share(s, line.tail<3>(), sizes);
  covariance += voltmeter.gain + voltmeter.offset;
  OutputVector out = OutputVector::Zero();
  out.head<12>() = covariance.diagonal();
  out.segment<3>(kFirstIntrinsicAngle) =
      carried_covariance(intrinsic_jacobian(s), covariance).diagonal().segment<3>(3);
  return out;
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
  prediction.duration = estimate_duration(plan, protocol, bench.speed, reading_rate_hz(bench));
  OutputVector variance = OutputVector::Zero();
  std::vector<Budget> budgets;
  for (int run = 1; run <= kCheckedRuns; ++run) {
    budgets.push_back(predicted_budget(bench, protocol, plan, prediction.duration, run));
    variance += budgets.back().combined.cwiseAbs2() / double{kCheckedRuns};
  }
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    const int worst = worst_output(static_cast<PlannedOutput>(group), variance);
    prediction.u[group] = std::sqrt(variance[worst]);
    prediction.limits[group] = largest_part(budgets.front(), worst);
  }
  return prediction;
}

PlannedCircles::PlannedCircles(const PlanningBench& bench, const ProtocolConfig& protocol)
    : bench_(bench), protocol_(protocol), plan_(make_rotation_plan(protocol, bench.travel)) {}

ProtocolConfig PlannedCircles::protocol(int readings) const {
  ProtocolConfig protocol = protocol_;
  protocol.dwell_readings = readings;
  return protocol;
}

PlanDuration PlannedCircles::duration(int readings) const {
  return estimate_duration(plan_, protocol(readings), bench_.speed, reading_rate_hz(bench_));
}

const PlannedValues& PlannedCircles::u(int readings) {
  if (const auto known = known_.find(readings); known != known_.end()) return known->second;
  const ProtocolConfig planned = protocol(readings);
  return known_[readings] =
             planned.estimator == "joint" ? fisher_u(planned) : predict_plan(bench_, planned).u;
}

PlannedValues PlannedCircles::fisher_u(const ProtocolConfig& protocol) {
  try {
    if (!fit_) {
      const RunRecord record = ideal_record(bench_, protocol, plan_, 1.0, {.stated = bench_.item.noise});
      JointOptions options;
      options.measured_alignment = record.measured_alignment;
      fit_.emplace(record, options);
    }
    const OutputVector variance =
        variances(fit_->line(), fit_->covariance_line(readings_per_dwell(protocol, reading_rate_hz(bench_))),
                  bench_.config.items.front().tolerances);
    PlannedValues u{};
    for (std::size_t group = 0; group < kPlannedOutputs; ++group)
      u[group] = std::sqrt(variance[worst_output(static_cast<PlannedOutput>(group), variance)]);
    return u;
  } catch (const UnusableData& error) {
    throw_no_matrix(protocol, error.message());
  }
}

Budget predict_budget(const PlanningBench& bench, const ProtocolConfig& protocol) {
  const std::vector<PlannedAngle> plan = make_rotation_plan(protocol, bench.travel);
  const PlanDuration duration = estimate_duration(plan, protocol, bench.speed, reading_rate_hz(bench));
  return predicted_budget(bench, protocol, plan, duration, 1);
}

}  // namespace abcal
