// One run of 3 x 72 angles (648 readings) through each estimator, on one core.

#include <benchmark/benchmark.h>

#include <random>

#include "protocol/analysis/analyse.h"
#include "protocol/analysis/joint_fit.h"
#include "protocol/analysis/norm_fit.h"
#include "protocol/model/forward_model.h"

namespace {

using namespace abcal;

/// A near-unit accelerometer on a stage with errors at their tolerances, with 1e-5 R of noise.
RunRecord simulated_record() {
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
    for (int n = 0; n < 72; ++n) list.push_back(error());
  }
  AccelerometerModel accelerometer;
  accelerometer.sensitivity_matrix(0, 1) = 0.05;
  accelerometer.offset = Eigen::Vector3d(0.1, -0.05, 0.02);
  accelerometer.k2 = Eigen::Vector3d(1e-3, -1e-3, 1e-3);
  RunRecord record;
  for (int i = 1; i <= 3; ++i) {
    for (int n = 1; n <= 72; ++n) {
      DwellRecord dwell;
      dwell.experiment = i;
      dwell.n = n;
      dwell.alpha = Angle::degrees(5.0 * (n - 1));
      dwell.mean = response(accelerometer, gravity_in_aut(i, n, dwell.alpha, stage));
      for (double& value : dwell.mean) value += 1e-5 * normal(engine);
      dwell.u_mean = Eigen::Vector3d::Constant(1e-5);
      dwell.time_s = 72.0 * i + n;
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

void BM_Joint(benchmark::State& state) {
  const RunRecord record = simulated_record();
  for (auto _ : state) benchmark::DoNotOptimize(analyse_joint(record));
}
BENCHMARK(BM_Joint)->Unit(benchmark::kMillisecond);

void BM_Norm(benchmark::State& state) {
  const RunRecord record = simulated_record();
  for (auto _ : state) benchmark::DoNotOptimize(analyse_norm(record));
}
BENCHMARK(BM_Norm)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
