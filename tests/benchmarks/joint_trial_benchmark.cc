// A trial of the joint Monte Carlo (JointTrials): of 3 x 72 angles with every effect at its default size, and
// of the runs named in ABCAL_BENCHMARK_RUNS (run files, separated by colons), such as one at a constant rate.
// ABCAL_BENCHMARK_TRIALS=N prints the errors of the first N trials instead, in units of their standard
// deviations, to compare two versions of the program.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/model/forward_model.h"
#include "protocol/record/run_file.h"
#include "protocol/uncertainty/joint_trials.h"

namespace {

using namespace abcal;

/// A near-unit accelerometer on a stage with errors at their tolerances; 1000 readings at each angle.
RunRecord stepped_record() {
  constexpr int kSteps = 72;
  constexpr double kNoise = 1e-5;
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
    for (int n = 0; n < kSteps; ++n) list.push_back(error());
  }
  AccelerometerModel accelerometer;
  accelerometer.sensitivity_matrix(0, 1) = 0.05;
  accelerometer.offset = Eigen::Vector3d(0.1, -0.05, 0.02);
  RunRecord record;
  record.source = "3 x 72";
  record.steps = kSteps;
  for (int i = 1; i <= 3; ++i) {
    for (int n = 1; n <= kSteps; ++n) {
      DwellRecord dwell;
      dwell.experiment = i;
      dwell.n = n;
      dwell.alpha = Angle::degrees(360.0 / kSteps * (n - 1));
      dwell.mean = response(accelerometer, gravity_in_aut(i, n, dwell.alpha, stage));
      for (double& value : dwell.mean) value += kNoise * normal(engine);
      dwell.count = 1000;
      dwell.u_mean = Eigen::Vector3d::Constant(kNoise);
      dwell.spread = *dwell.u_mean * std::sqrt(1000.0);
      dwell.time_s = static_cast<double>(kSteps * i + n);
      record.dwells.push_back(dwell);
    }
  }
  return record;
}

struct Study {
  explicit Study(RunRecord measured)
      : record(std::move(measured)), own(fit_item(record, {})), trials(own, record, 1) {}
  RunRecord record;
  ItemFit own;
  JointTrials trials;
};

void run_trials(benchmark::State& state, const Study& study) {
  constexpr std::size_t kBlock = 1000;
  std::vector<double> out(kStudyOutputs * kBlock);
  std::uint64_t first = 0;
  for (auto _ : state) {
    study.trials(first, kBlock, out.data());
    benchmark::DoNotOptimize(out.data());
    first += kBlock;
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kBlock));
}

void print_errors(const Study& study, std::size_t count) {
  std::vector<double> out(kStudyOutputs * count);
  study.trials(0, count, out.data());
  for (int k = 0; k < kStudyOutputs; ++k) {
    double square = 0.0;
    const double* errors = out.data() + static_cast<std::size_t>(k) * count;
    for (std::size_t t = 0; t < count; ++t) square += errors[t] * errors[t] / static_cast<double>(count);
    for (std::size_t t = 0; t < count; ++t)
      fmt::print("{} {} {} {:.9f}\n", study.record.source, output_symbol(k), t,
                 errors[t] / std::sqrt(square));
  }
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  std::vector<std::unique_ptr<Study>> studies;
  studies.push_back(std::make_unique<Study>(stepped_record()));
  const char* runs = std::getenv("ABCAL_BENCHMARK_RUNS");
  std::istringstream names(runs != nullptr ? runs : "");
  for (std::string name; std::getline(names, name, ':');)
    studies.push_back(std::make_unique<Study>(RunFile::load(name).record));
  const char* count = std::getenv("ABCAL_BENCHMARK_TRIALS");
  for (const std::unique_ptr<Study>& study : studies) {
    if (count != nullptr) {
      print_errors(*study, std::stoul(count));
    } else {
      benchmark::RegisterBenchmark(("BM_ThousandTrials/" + study->record.source).c_str(),
                                   [&study](benchmark::State& state) { run_trials(state, *study); })
          ->Unit(benchmark::kMillisecond);
    }
  }
  if (count == nullptr) benchmark::RunSpecifiedBenchmarks();
}
