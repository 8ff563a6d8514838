// One run of 3 x 72 angles (648 readings) through each estimator, on one core, and how the joint fit grows
// with the number of angles (3 x 360: five times the work).

#include <benchmark/benchmark.h>

#include <random>
#include <vector>

#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/norm/norm_fit.h"
#include "protocol/model/forward_model.h"

namespace {

using namespace abcal;

/// A near-unit accelerometer on a stage with errors at their tolerances, with 1e-5 R of noise.
RunRecord simulated_record(int steps = 72) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  const auto error = [&] { return Angle::degrees(0.008 * normal(engine)); };
  AcsErrors stage;
  stage.alignment = {1e-4, -1e-4, 1e-4};
  stage.d2 = error();
  stage.d3 = error();
  stage.mean_step_x = error();
  stage.mean_step_z = error();
  for (auto& list : stage.step_errors) {
    for (int n = 0; n < steps; ++n) list.push_back(error());
  }
  AccelerometerModel accelerometer;
  accelerometer.sensitivity_matrix(0, 1) = 0.05;
  accelerometer.offset = Eigen::Vector3d(0.1, -0.05, 0.02);
  accelerometer.k2 = Eigen::Vector3d(1e-3, -1e-3, 1e-3);
  RunRecord record;
  record.steps = steps;
  for (int i = 1; i <= 3; ++i) {
    for (int n = 1; n <= steps; ++n) {
      DwellRecord dwell;
      dwell.experiment = i;
      dwell.n = n;
      dwell.alpha = Angle::degrees(360.0 / steps * (n - 1));
      dwell.mean = response(accelerometer, gravity_in_aut(i, n, dwell.alpha, stage));
      for (double& value : dwell.mean) value += 1e-5 * normal(engine);
      dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
      dwell.time_s = static_cast<double>(steps * i + n);
      record.dwells.push_back(dwell);
    }
  }
  return record;
}

void BM_Abc(benchmark::State& state) {
  const RunRecord record = simulated_record();
  for (auto _ : state) benchmark::DoNotOptimize(analyse_abc(record));
}
BENCHMARK(BM_Abc)->Unit(benchmark::kMillisecond);

/// The whole analysis, with the search for the noise and the tests of the verdict.
void BM_Joint(benchmark::State& state) {
  const RunRecord record = simulated_record(static_cast<int>(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(analyse_joint(record));
}
BENCHMARK(BM_Joint)->Arg(72)->Arg(360)->Unit(benchmark::kMillisecond);

/// One fit with every effect and given noise.
void BM_FitOfGivenNoise(benchmark::State& state) {
  const RunRecord record = simulated_record(static_cast<int>(state.range(0)));
  std::vector<EffectReading> readings;
  const auto count = static_cast<double>(record.dwells.size());
  for (const DwellRecord& dwell : record.dwells) {
    const SinCos alpha = sincos(dwell.alpha);
    const double t = static_cast<double>(readings.size()) / (count - 1.0) - 0.5;
    readings.push_back({dwell.experiment, alpha.sin, alpha.cos, t, dwell.mean, *dwell.u_mean, -1});
  }
  EffectFitOptions options;
  options.noise_process = false;
  for (auto _ : state) benchmark::DoNotOptimize(effect_fit(readings, options));
}
BENCHMARK(BM_FitOfGivenNoise)->Arg(72)->Arg(360)->Unit(benchmark::kMillisecond);

void BM_Norm(benchmark::State& state) {
  const RunRecord record = simulated_record();
  for (auto _ : state) benchmark::DoNotOptimize(analyse_norm(record));
}
BENCHMARK(BM_Norm)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
