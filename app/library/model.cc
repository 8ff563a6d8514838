#include "abcal/model.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

#include "app/library/data.h"
#include "app/studies/robustness/robustness_study.h"
#include "protocol/model/forward_model.h"

namespace abcal::v1 {
namespace {

::abcal::AcsErrors model_errors(const StageErrors& errors) {
  ::abcal::AcsErrors model;
  model.alignment = {errors.zx, errors.zy, errors.xz};
  model.d2 = ::abcal::Angle::degrees(errors.initial_turn_z_deg);
  model.d3 = ::abcal::Angle::degrees(errors.initial_turn_x_deg);
  model.mean_step_x = ::abcal::Angle::degrees(errors.mean_step_x_deg);
  model.mean_step_z = ::abcal::Angle::degrees(errors.mean_step_z_deg);
  return model;
}

void set_axis(const SimulatedWorld& world, ::abcal::sim::AxisTruth& axis) {
  axis.step_error_sd = ::abcal::Angle::degrees(world.step_deg);
  axis.smooth_error_sd = ::abcal::Angle::degrees(world.smooth_step_deg);
  axis.wobble_sd_urad = world.wobble_urad;
}

::abcal::sim::BenchTruth truth_of(const SimulatedWorld& world) {
  ::abcal::sim::BenchTruth truth;
  truth.seed = world.seed;
  truth.sensitivity_matrix = world.item.sensitivity_matrix;
  truth.offset = world.item.offset;
  truth.k2 = world.item.k2;
  truth.k3 = world.item.k3;
  truth.hysteresis = world.hysteresis;
  truth.drift_1 = world.drift;
  truth.noise = world.noise;
  truth.zx = world.stage.zx;
  truth.zy = world.stage.zy;
  truth.xz = world.stage.xz;
  truth.x.mean_step_error = ::abcal::Angle::degrees(world.stage.mean_step_x_deg);
  truth.z.mean_step_error = ::abcal::Angle::degrees(world.stage.mean_step_z_deg);
  truth.x.initial_turn_error = ::abcal::Angle::degrees(world.stage.initial_turn_x_deg);
  truth.z.initial_turn_error = ::abcal::Angle::degrees(world.stage.initial_turn_z_deg);
  set_axis(world, truth.x);
  set_axis(world, truth.z);
  truth.span_s = world.angle_period_s * 3.0 * (world.steps + 1);
  return truth;
}

void require(bool right, const char* what, double found, const char* required) {
  if (right) return;
  throw std::invalid_argument(fmt::format("simulate: {}: found {:g}; required: {}", what, found, required));
}

void check(const SimulatedWorld& world) {
  constexpr int kMostSteps = 3600;
  constexpr double kLongestPeriod = 1e5;
  require(world.steps >= 3 && world.steps <= kMostSteps, "steps", world.steps, "3 to 3600");
  require(world.angle_period_s > 0.0 && world.angle_period_s <= kLongestPeriod, "angle_period_s",
          world.angle_period_s, "above 0 and at most 1e5 s");
  require(std::isfinite(world.noise) && world.noise >= 0.0, "noise", world.noise,
          "a standard deviation >= 0");
  require(world.item.sensitivity_matrix.allFinite(), "sensitivity_matrix", std::nan(""), "finite numbers");
  const double rows = world.item.sensitivity_matrix.rowwise().norm().minCoeff();
  require(rows > 0.0, "sensitivity_matrix, norm of a row", rows, "above 0");
}

}  // namespace

Eigen::Vector3d specific_force(int experiment, double alpha_deg, const StageErrors& errors) {
  // Individual step errors are zero here, so that the value of n does not matter.
  return ::abcal::gravity_in_aut(experiment, 1, ::abcal::Angle::degrees(alpha_deg), model_errors(errors));
}

Eigen::Vector3d response(const Item& item, const Eigen::Vector3d& specific_force_gloc) {
  ::abcal::AccelerometerModel model;
  model.sensitivity_matrix = item.sensitivity_matrix;
  model.offset = item.offset;
  model.k2 = item.k2;
  model.k3 = item.k3;
  return ::abcal::response(model, specific_force_gloc);
}

SimulatedRecord simulate(const SimulatedWorld& world) {
  check(world);
  ::abcal::ScenarioBench bench;
  bench.truth = truth_of(world);
  set_effects(world.effects, bench.stated);
  bench.steps = world.steps;
  bench.noise = world.noise;
  bench.stated_noise = world.noise;
  bench.scale = world.item.sensitivity_matrix.rowwise().norm().mean();
  bench.angle_period_s = world.angle_period_s;
  ::abcal::SimulatedRun run = ::abcal::simulate_run(bench);
  run.record.source = "simulation";
  if (!world.response_unit.empty()) run.record.response_unit = world.response_unit;
  return {Record(std::make_shared<const Record::Data>(Record::Data{std::move(run.record)})),
          run.truth.sensitivity_matrix, run.truth.offset};
}

}  // namespace abcal::v1
