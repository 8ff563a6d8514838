#pragma once

#include <Eigen/Geometry>
#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "drivers/instrument/mounted_stage.h"
#include "protocol/plan/limits.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_bench.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"

namespace abcal::test {

/// A whole run on a simulated bench inside the test: plan, instruments, run file.
struct SimulatedRun {
  SimulatedRun() {
    protocol.steps = 12;
    protocol.step = Angle::degrees(30.0);
    protocol.settle_s = 0.2;
    protocol.check_poses = false;
    protocol.dwell_readings = 50;
    truth.noise = 1e-4;
    truth.quantisation = 1e-6;
  }

  sim::BenchTruth truth;
  ProtocolConfig protocol;
  LimitsConfig limits;
  Tolerances tolerances;
  ExpectedItem expected;
  std::string unit = "g";
  double g_loc_mps2 = 9.80101;
  std::array<int, 2> stage_sign{1, 1};  ///< -1: the axis counts the wrong way, and no key states it.
  /// Called before the run begins.
  std::function<void(sim::SimBench& world, Clock::Instant now)> before_run;
  /// Called after each angle, with how many there are.
  std::function<void(sim::SimBench& world, Clock::Instant now, std::size_t dwells)> after_dwell;

  std::vector<std::string> notices;  ///< Notices of the last run.
  std::vector<PlannedAngle> plan;

  /// Measures into a new file and loads it again.
  StoredRun measure(const std::filesystem::path& path) {
    notices.clear();
    sim::SimClock clock;
    const auto world = std::make_shared<sim::SimBench>(truth, clock.now());
    MountedStage stage(std::make_unique<sim::SimStage>(world, clock),
                       {AxisMounting{Angle{}, stage_sign[0], {}, {}}, {Angle{}, stage_sign[1], {}, {}}});
    sim::SimAccelerometer accelerometer(world, clock, 100.0, unit);
    plan = make_rotation_plan(protocol, {});
    RunHeader header;
    header.response_unit = unit;
    header.g_loc.value_mps2 = g_loc_mps2;
    header.g_loc.expanded_uncertainty_mps2 = 3e-5;
    header.tolerances = tolerances;
    header.limits = limits;
    header.expected = expected;
    header.step = protocol.step;
    header.steps = protocol.steps;
    header.plan = plan;
    {
      RunFile file = RunFile::create(path, header);
      Observer observer(*this, *world, clock);
      if (before_run) before_run(*world, clock.now());
      run_experiments({stage, clock, {{1, accelerometer, limits, tolerances, expected}}},
                      {plan, settings(), {}}, file, observer, std::stop_source().get_token());
    }
    return RunFile::load(path);
  }

  /// An accelerometer and a stage as [tolerances] allow them, each error drawn.
  void draw_healthy(std::uint64_t seed) {
    std::mt19937_64 engine(seed);
    std::normal_distribution<double> normal;
    const auto draw = [&](double sd) { return sd * normal(engine); };
    const auto draw_angle = [&](Angle sd) { return Angle::degrees(draw(sd.deg())); };
    truth.seed = seed;
    const double alignment = sincos(tolerances.alignment).sin;
    truth.zx = draw(alignment);
    truth.zy = draw(alignment);
    truth.xz = draw(alignment);
    for (sim::AxisTruth* axis : {&truth.x, &truth.z}) {
      axis->step_error_sd = tolerances.step;
      axis->mean_step_error = draw_angle(tolerances.zero);
      axis->initial_turn_error = draw_angle(tolerances.initial_turn);
      axis->backlash = Angle::degrees(0.01);
    }
    // Within 0.15 % of g, 1 degree askew, axes orthogonal within 0.5 degrees.
    Eigen::Matrix3d s = Eigen::Matrix3d::Identity();
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) s(j, k) += draw(j == k ? 0.0005 : 0.005);
    }
    const Eigen::Vector3d askew(draw(0.01), draw(0.01), draw(0.01));
    truth.sensitivity_matrix = g_loc_mps2 / kStandardGravity * s *
                               Eigen::AngleAxisd(askew.norm(), askew.normalized()).toRotationMatrix();
    for (int j = 0; j < 3; ++j) truth.offset(j) = draw(0.02);
    truth.ring_down_amplitude = 1e-4;
    truth.temperature_per_hour = draw(0.3);
    drift = Eigen::Vector3d(draw(tolerances.drift), draw(tolerances.drift), draw(tolerances.drift));
  }

  /// Drift over the run, relative to the sensitivity; set_drift() needs to know how long the run takes.
  Eigen::Vector3d drift = Eigen::Vector3d::Zero();
  void set_drift(double run_s) {
    truth.drift_per_hour = drift.cwiseProduct(truth.sensitivity_matrix.rowwise().norm()) * (3600.0 / run_s);
  }

 private:
  RunSettings settings() const { return {protocol, limits, tolerances, expected, g_loc_mps2}; }

  class Observer final : public RunObserver {
   public:
    Observer(SimulatedRun& run, sim::SimBench& world, Clock& clock)
        : run_(run), world_(world), clock_(clock) {}
    void phase(std::size_t, RunPhase) override {}
    void dwells(std::size_t, std::span<const ItemDwell>) override {
      ++count_;
      if (run_.after_dwell) run_.after_dwell(world_, clock_.now(), count_);
    }
    void notice(std::string_view, const Message& text, std::optional<int>) override {
      run_.notices.emplace_back(text);
    }

   private:
    SimulatedRun& run_;
    sim::SimBench& world_;
    Clock& clock_;
    std::size_t count_ = 0;
  };
};

}  // namespace abcal::test
