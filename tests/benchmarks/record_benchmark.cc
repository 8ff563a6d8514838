// Cost of a long dwell: its statistics, and its way to the disk and back. Argument: readings.

#include <benchmark/benchmark.h>

#include <cmath>
#include <filesystem>
#include <random>
#include <vector>

#include "protocol/record/reading_statistics.h"
#include "protocol/record/run_file.h"
#include "protocol/record/verify_run.h"
#include "tests/support/temporary_folder.h"

namespace {

using namespace abcal;

/// Readings whose noise correlates over some 1 / (1 - correlation) of them.
std::vector<StoredReading> correlated_readings(std::size_t count, double correlation) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  std::vector<StoredReading> readings(count);
  Eigen::Vector3d noise = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < count; ++k) {
    for (double& value : noise)
      value = correlation * value + std::sqrt(1.0 - correlation * correlation) * normal(engine);
    readings[k].sequence = k;
    readings[k].time_s = 1e-3 * static_cast<double>(k);
    readings[k].output = 1e-4 * noise;
    readings[k].temperature_degc = static_cast<double>(static_cast<float>(23.0 + 1e-3 * noise[0]));
  }
  return readings;
}

void statistics(benchmark::State& state, double correlation) {
  std::vector<Eigen::Vector3d> outputs;
  for (const StoredReading& reading :
       correlated_readings(static_cast<std::size_t>(state.range(0)), correlation))
    outputs.push_back(reading.output);
  for (auto _ : state) benchmark::DoNotOptimize(reading_statistics(outputs, 1e-7));
}
BENCHMARK_CAPTURE(statistics, uncorrelated, 0.0)->Arg(1'000)->Arg(1'000'000)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(statistics, correlated, 0.9999)
    ->Arg(60'000)
    ->Arg(120'000)
    ->Arg(1'000'000)
    ->Unit(benchmark::kMillisecond);

/// Size of the closed run file of one dwell.
double file_size(const RunHeader& header, const DwellRecord& dwell,
                 const std::vector<StoredReading>& readings) {
  const test::TemporaryFolder folder;
  RunFile file = RunFile::create(folder / "a.run", header);
  file.append_dwell(0, dwell, readings, {});
  file.close_complete("2026-11-22T09:00:00.000Z", {});
  return static_cast<double>(std::filesystem::file_size(folder / "a.run"));
}

void write_dwell(benchmark::State& state) {
  const std::vector<StoredReading> readings =
      correlated_readings(static_cast<std::size_t>(state.range(0)), 0.9);
  DwellRecord dwell;
  dwell.experiment = dwell.n = 1;
  RunHeader header;
  header.plan.push_back({1, 1, false, Angle{}, Angle{}, Angle{}});
  for (auto _ : state) {
    state.PauseTiming();
    const test::TemporaryFolder folder;
    RunFile file = RunFile::create(folder / "a.run", header);
    state.ResumeTiming();
    file.append_dwell(0, dwell, readings, {});
  }
  // Readings only, without the tables of the run.
  state.counters["bytes_per_reading"] = (file_size(header, dwell, readings) - file_size(header, dwell, {})) /
                                        static_cast<double>(readings.size());
}
BENCHMARK(write_dwell)->Arg(1'000)->Arg(1'000'000)->Unit(benchmark::kMillisecond);

void verify_dwell(benchmark::State& state) {
  const std::vector<StoredReading> readings =
      correlated_readings(static_cast<std::size_t>(state.range(0)), 0.9);
  const test::TemporaryFolder folder;
  DwellRecord dwell;
  dwell.experiment = dwell.n = 1;
  RunHeader header;
  header.plan.push_back({1, 1, false, Angle{}, Angle{}, Angle{}});
  RunFile file = RunFile::create(folder / "a.run", header);
  file.append_dwell(0, dwell, readings, {});
  for (auto _ : state) benchmark::DoNotOptimize(verify_run(folder / "a.run"));
}
BENCHMARK(verify_dwell)->Arg(1'000'000)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
