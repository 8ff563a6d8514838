// Cost of the program itself on a bench in real time: the emulator runs in a process of its own, the bytes go
// over pseudo-terminals. Prints the overhead of a run.

#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <numeric>

#include "protocol/record/run_file.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace {

using namespace abcal;
using namespace std::chrono_literals;

constexpr double kSpeed = 20.0;          // deg/s
constexpr double kAcceleration = 400.0;  // deg/s2
constexpr double kStep = 5.0;            // deg
constexpr double kSettle = 0.2;          // s
constexpr int kReadings = 40;            // at 200 Hz: 0.2 s
constexpr double kRate = 200.0;

std::string bench_text(double rate_hz) {
  return fmt::format(
      "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"links/stage\"\n"
      "[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"links/accelerometer\"\nrate_hz = {}\n"
      "[protocol]\nsteps = 20\nstep_deg = {}\nsettle_s = {}\ndwell_readings = {}\nclosing_angle = "
      "false\ncheck_poses = false\n"
      "[simulation]\nnoise = 1e-4\n"
      "[simulation.x]\nspeed_deg_per_s = {}\nacceleration_deg_per_s2 = {}\n"
      "[simulation.z]\nspeed_deg_per_s = {}\nacceleration_deg_per_s2 = {}\n",
      rate_hz, kStep, kSettle, kReadings, kSpeed, kAcceleration, kSpeed, kAcceleration);
}

class EmulatedBench {
 public:
  explicit EmulatedBench(double rate_hz) {
    test::write_file(folder / "bench.toml", bench_text(rate_hz));
    emulator.emplace(std::vector<std::string>{"emulate", "bench.toml", "--link-dir", "links"}, folder.path());
    if (!test::wait_for([&] { return std::filesystem::exists(folder / "links/accelerometer"); }, 20s)) {
      throw std::runtime_error("the emulator did not start: " + emulator->err());
    }
  }
  test::TemporaryFolder folder;
  std::optional<test::Program> emulator;
};

/// Overhead as the run accounts for it (no motion, settling or dwell pending), and, harder, the time beyond
/// what the motion profile, the settle time and the readings need by themselves.
void BM_RunOverPseudoTerminals(benchmark::State& state) {
  for (auto _ : state) {
    EmulatedBench bench(kRate);
    const test::ProgramResult run =
        test::run_program({"run", "bench.toml", "-o", "a.run", "--json"}, bench.folder.path());
    if (run.exit_code != 0) {
      state.SkipWithError(run.err.c_str());
      return;
    }
    const auto timing = nlohmann::json::parse(run.out)["run"]["timing"];
    const double moving = timing["moving_s"], settling = timing["settling_s"],
                 dwelling = timing["dwelling_s"], overhead = timing["overhead_s"];
    state.counters["overhead_percent"] = 100.0 * overhead / (moving + settling + dwelling + overhead);

    // Angle by angle, inside a sweep: from the middle of one dwell to the middle of the next.
    const StoredRun stored = RunFile::load(bench.folder / "a.run");
    const double ideal = kStep / kSpeed + kSpeed / kAcceleration + kSettle + kReadings / kRate;
    std::vector<double> excess;
    for (std::size_t k = 1; k < stored.record.dwells.size(); ++k) {
      const DwellRecord &a = stored.record.dwells[k - 1], &b = stored.record.dwells[k];
      if (a.experiment == b.experiment) excess.push_back(*b.time_s - *a.time_s - ideal);
    }
    state.counters["ideal_ms_per_angle"] = 1e3 * ideal;
    state.counters["excess_ms_per_angle"] =
        1e3 * std::accumulate(excess.begin(), excess.end(), 0.0) / static_cast<double>(excess.size());
    state.counters["excess_percent"] = 100.0 * state.counters["excess_ms_per_angle"] / (1e3 * ideal);
  }
}
BENCHMARK(BM_RunOverPseudoTerminals)->Iterations(1)->Unit(benchmark::kSecond);

}  // namespace

BENCHMARK_MAIN();
