// How long a whole trial of Simulation Set ABC1 takes (draw errors and an accelerometer, model, fit,
// intrinsic properties), by the sums of the step errors and step by step (219 normals), compared with the two
// yardsticks of docs/uncertainty.md, and how a study scales with threads. Prints the ratios at the end of one
// run.
#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "protocol/uncertainty/published_tables.h"
#include "protocol/uncertainty/type_b.h"
#include "protocol/uncertainty/type_b_kernel.h"

namespace {

constexpr std::size_t kBatch = 1000;
constexpr int kNormals = 219;  // Zx, Zy, Xz and 216 step errors
constexpr std::uint32_t kPairs =
    4 + 9 + 5;  // drawn by a trial: alignment and turns, sums of step errors, accelerometer

abcal::TypeBStudy abc1() {
  abcal::TypeBStudy study;
  study.tolerances = abcal::paper_tolerances();
  study.accelerometer_spread = 0.1;
  return study;
}

void run_trials(benchmark::State& state, bool each_step) {
  abcal::TypeBStudy study = abc1();
  study.each_step = each_step;
  const abcal::TypeBSampler sampler(study);
  std::vector<double> out(abcal::kStudyOutputs * kBatch);
  std::uint64_t first = 0;
  for (auto _ : state) {
    sampler(first, kBatch, out.data());
    benchmark::DoNotOptimize(out.data());
    first += kBatch;
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kBatch));
}

void BM_Abc1Trial(benchmark::State& state) {
  run_trials(state, false);
}
BENCHMARK(BM_Abc1Trial);

void BM_Abc1TrialStepByStep(benchmark::State& state) {
  run_trials(state, true);
}
BENCHMARK(BM_Abc1TrialStepByStep);

void BM_ItsNormalsAlone(benchmark::State& state) {
  std::vector<double> out(kBatch);
  std::uint64_t first = 0;
  for (auto _ : state) {
    abcal::type_b_normals_only(1, kPairs, first, kBatch, out.data());
    benchmark::DoNotOptimize(out.data());
    first += kBatch;
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kBatch));
}
BENCHMARK(BM_ItsNormalsAlone);

void BM_HarmonicTrial(benchmark::State& state) {
  abcal::TypeBStudy study = abc1();
  study.step_errors = abcal::StepErrorModel::kHarmonic;
  const abcal::TypeBSampler sampler(study);
  std::vector<double> out(abcal::kStudyOutputs * kBatch);
  std::uint64_t first = 0;
  for (auto _ : state) {
    sampler(first, kBatch, out.data());
    benchmark::DoNotOptimize(out.data());
    first += kBatch;
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kBatch));
}
BENCHMARK(BM_HarmonicTrial);

void BM_StandardNormals219(benchmark::State& state) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  for (auto _ : state) {
    double sum = 0.0;
    for (std::size_t i = 0; i < kBatch * kNormals; ++i) sum += normal(engine);
    benchmark::DoNotOptimize(sum);
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kBatch));
}
BENCHMARK(BM_StandardNormals219);

// The NumPy script times itself; starting Python and drawing its first numbers is not counted.
void BM_Abc1NumPy(benchmark::State& state) {
  // Not every python3 of a machine has NumPy: the first that has.
  std::string output;
  for (const char* python : {"python3", "/usr/bin/python3"}) {
    const std::string command = fmt::format("{} '{}' 4000 2>/dev/null", python, ABCAL_NUMPY_SCRIPT);
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> pipe(::popen(command.c_str(), "r"), ::pclose);
    std::array<char, 4096> buffer{};
    output.clear();
    while (pipe && std::fgets(buffer.data(), static_cast<int>(buffer.size()), pipe.get()))
      output += buffer.data();
    if (!output.empty()) break;
  }
  const nlohmann::json result = nlohmann::json::parse(output, nullptr, false);
  if (result.is_discarded()) {
    state.SkipWithError("no python3 with NumPy (Debian: python3-numpy)");
    return;
  }
  // The yardstick must do the same work: its standard deviations are those of ours.
  abcal::MonteCarloOptions options;
  options.trials = 4000;
  const abcal::MonteCarloResult ours = abcal::run_type_b(abc1(), options);
  for (int k = 0; k < abcal::kStudyOutputs; ++k) {
    const double theirs = result["standard_deviation"][static_cast<std::size_t>(k)].get<double>();
    // Standard deviations of 4000 trials differ by 2.2 % (two standard deviations of their difference 3.2 %;
    // the diagonals and phi_uv have long tails).
    if (std::abs(theirs / ours.standard_deviation(k) - 1.0) > 0.15) {
      state.SkipWithError("the NumPy script and abcal disagree: they do not do the same work");
      return;
    }
  }
  const double seconds = result["seconds"].get<double>() / result["trials"].get<double>() * kBatch;
  for (auto _ : state) state.SetIterationTime(seconds);
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(kBatch));
}
BENCHMARK(BM_Abc1NumPy)->UseManualTime()->Iterations(1);

// A whole study with means, covariance and both kinds of interval.
void BM_MillionTrials(benchmark::State& state) {
  abcal::MonteCarloOptions options;
  options.trials = 1'000'000;
  options.threads = static_cast<unsigned>(state.range(0));
  for (auto _ : state) benchmark::DoNotOptimize(abcal::run_type_b(abc1(), options).covariance.data());
}
BENCHMARK(BM_MillionTrials)
    ->RangeMultiplier(2)
    ->Range(1, 8)
    ->UseRealTime()
    ->Iterations(1)
    ->Unit(benchmark::kSecond);

/// Whether a benchmark has failed; Google Benchmark 1.8 renamed the member.
template <class Run>
bool has_failed(const Run& run) {
  if constexpr (requires { run.error_occurred; }) {
    return run.error_occurred;
  } else {
    return static_cast<int>(run.skipped) != 0;
  }
}

class RatioReporter : public benchmark::ConsoleReporter {
 public:
  void ReportRuns(const std::vector<Run>& runs) override {
    ConsoleReporter::ReportRuns(runs);
    for (const Run& run : runs) {
      if (has_failed(run) || run.run_type != Run::RT_Iteration) continue;
      // Processor time where one core is compared with one core, so that a busy machine does not spoil the
      // ratios.
      const bool wall = run.benchmark_name().find("_time") != std::string::npos;
      const double seconds =
          (wall ? run.real_accumulated_time : run.cpu_accumulated_time) / static_cast<double>(run.iterations);
      const auto [it, is_new] = seconds_.try_emplace(run.benchmark_name(), seconds);
      if (!is_new)
        it->second = std::min(it->second, seconds);  // the best of repetitions: the least disturbed
    }
  }

  void print_ratios() const {
    const auto trial = find("BM_Abc1Trial");
    if (!trial) return;
    fmt::print("\nA whole ABC1 trial on one core ({}): {:.2f} us (aim: 3 us)\n", abcal::vector_target(),
               *trial / kBatch * 1e6);
    const auto print_ratio = [&](const char* what, const char* name, const char* required) {
      const auto other = find(name);
      if (other) fmt::print("  {:<58} {:6.1f} times as long{}\n", what, *other / *trial, required);
    };
    print_ratio("batched NumPy, section 2's equations as they stand:",
                "BM_Abc1NumPy/iterations:1/manual_time", " (required: 20)");
    print_ratio("219 std::normal_distribution over std::mt19937_64 alone:", "BM_StandardNormals219",
                " (required: 1)");
    print_ratio("the same, each of 216 step errors drawn:", "BM_Abc1TrialStepByStep", "");
    print_ratio("a trial with a spectrum of step errors (Eq. 14):", "BM_HarmonicTrial", "");
    if (const auto normals = find("BM_ItsNormalsAlone")) {
      fmt::print("  {:<58} {:6.0f} % of it\n", "its own random numbers:", 100.0 * *normals / *trial);
    }
    const auto one = find("BM_MillionTrials/1/iterations:1/real_time");
    if (!one) return;
    fmt::print("A million type B trials with covariance and both intervals ({} processors here):\n",
               std::thread::hardware_concurrency());
    for (const int threads : {1, 2, 4, 8}) {
      const auto many = find(fmt::format("BM_MillionTrials/{}/iterations:1/real_time", threads));
      if (many)
        fmt::print("  {} thread{}: {:.2f} s, {:.2f} times as fast\n", threads, threads == 1 ? "" : "s", *many,
                   *one / *many);
    }
  }

 private:
  std::optional<double> find(const std::string& name) const {
    const auto it = seconds_.find(name);
    return it == seconds_.end() ? std::nullopt : std::optional(it->second);
  }
  std::map<std::string, double> seconds_;
};

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  RatioReporter reporter;
  benchmark::RunSpecifiedBenchmarks(&reporter);
  reporter.print_ratios();
  benchmark::Shutdown();
  return 0;
}
