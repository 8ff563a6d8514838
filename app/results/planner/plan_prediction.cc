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

/// The means of an ideal record.
struct MeansOfRecord {
  int at_rest = 1;  ///< Number of readings in a mean at rest; those of a step in a sweep follow its rate.
  bool are_noisy = false;  ///< They have the noise that they state.
  std::uint64_t seed = 0;
};

/// The time of each angle from the first (s). Between two sweeps the stage stops and turns back.
/// @param angle_s  time from angle to angle where the stage stands
std::vector<double> times_of(const std::vector<PlannedAngle>& plan, const ProtocolConfig& protocol,
                             double angle_s) {
  std::vector<double> times;
  double time_s = 0.0;
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const double rate = std::abs(plan[i].rate_deg_per_s);
    const bool is_first =
        i == 0 || plan[i - 1].sweep != plan[i].sweep || plan[i - 1].experiment != plan[i].experiment;
    if (plan[i].sweep > 0)
      time_s += is_first ? 2.0 * rate / protocol.acceleration_deg_per_s2 : protocol.step.deg() / rate;
    times.push_back(time_s);
    if (plan[i].sweep == 0) time_s += angle_s;
  }
  return times;
}

/// Standard uncertainty of the angles of a sweep (degree). Nobody knows it before the run: an encoder that
/// answers every 10 ms, at times that are known to 1 ms, is assumed (SweepAngle::u_deg()).
double assumed_u_angle_deg(const PlannedAngle& angle) {
  constexpr double kTimeScatterS = 1e-3;
  constexpr double kSampleS = 0.01;
  const double rate = std::abs(angle.rate_deg_per_s);
  return rate * kTimeScatterS / std::sqrt(360.0 / rate / kSampleS);
}

/// Readings of the item on an ideal stage, in g_loc.
/// @param angle_s  time from angle to angle where the stage stands
RunRecord ideal_record(const PlanningBench& bench, const ProtocolConfig& protocol,
                       const std::vector<PlannedAngle>& plan, double angle_s, const MeansOfRecord& means) {
  const BenchConfig& config = bench.config;
  RunRecord record;
  record.source = "plan";
  const Tolerances& tolerances = config.items.front().tolerances;
  record.tolerances = protocol.is_constant_rate() ? with_effects_of_motion(tolerances) : tolerances;
  record.estimator = protocol.estimator;
  record.steps = protocol.steps;
  record.step = protocol.step;
  record.stage_record = bench.stage_record;
  record.expected.nominal_sensitivity = 1.0;
  record.expected.sensitivity_tolerance = 1.0;
  if (!config.stage.level_file.empty())
    record.measured_alignment = read_level_file(config.stage.level_file).alignment;
  sim::BenchTruth truth;
  truth.seed = means.seed;
  truth.sensitivity_matrix = bench.item.sensitivity_matrix;
  truth.offset = bench.item.offset;
  sim::SimBench world(truth);
  truth.noise = bench.item.noise;
  sim::SimBench noisy(truth);
  const std::vector<double> times = times_of(plan, protocol, angle_s);
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const PlannedAngle& angle = plan[i];
    DwellRecord dwell = planned_dwell(angle);
    const double readings = angle.sweep > 0
                                ? readings_of_step(protocol, angle.rate_deg_per_s, reading_rate_hz(bench))
                                : means.at_rest;
    dwell.count = static_cast<std::int64_t>(readings);
    dwell.time_s = times[i];
    if (dwell.motion) dwell.motion->u_angle_deg = assumed_u_angle_deg(angle);
    const Clock::Instant t = world.start() + from_seconds(times[i]);
    const auto output_of = [&](sim::SimBench& each) -> Eigen::Vector3d {
      each.place(StageAxis::kX, angle.x, t);
      each.place(StageAxis::kZ, angle.z, t);
      return each.output(t, i).value;
    };
    dwell.mean = output_of(world);
    if (means.are_noisy) dwell.mean += (output_of(noisy) - dwell.mean) / std::sqrt(readings);
    dwell.u_mean = Eigen::Vector3d::Constant(bench.item.noise / std::sqrt(readings));
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
  const RunRecord record =
      ideal_record(bench, protocol, plan, duration.total_s() / static_cast<double>(plan.size()),
                   {.at_rest = readings, .are_noisy = true, .seed = static_cast<std::uint64_t>(run)});
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
  if (protocol.is_constant_rate()) return fmt::format("3 x {} sweeps", protocol.sweeps);
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
  if (has_dwells()) protocol.dwell_readings = readings;
  return protocol;
}

PlanDuration PlannedCircles::duration(int readings) const {
  return estimate_duration(plan_, protocol(readings), bench_.speed, reading_rate_hz(bench_));
}

const PlannedValues& PlannedCircles::u(int readings) {
  const ProtocolConfig planned = protocol(readings);
  const auto [known, is_new] = known_.try_emplace(planned.dwell_readings);
  if (!is_new) return known->second;
  return known->second = planned.estimator == "joint" ? fisher_u(planned) : predict_plan(bench_, planned).u;
}

PlannedValues PlannedCircles::fisher_u(const ProtocolConfig& protocol) {
  try {
    const int readings = readings_per_dwell(protocol, reading_rate_hz(bench_));
    if (!fit_) {
      const RunRecord record =
          ideal_record(bench_, protocol, plan_, 1.0, {.at_rest = has_dwells() ? 1 : readings});
      JointOptions options;
      options.measured_alignment = record.measured_alignment;
      fit_.emplace(record, options);
    }
    const OutputVector variance = variances(fit_->line(), fit_->covariance_line(has_dwells() ? readings : 1),
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
