// Cost and losses of the fastest stream of every accelerometer, in real time over pseudo-terminals. The
// processor's share is that of the port's thread, the driver and its reader; the emulator, in a thread of its
// own, is not counted.

#include <benchmark/benchmark.h>

#include <string>
#include <vector>

#include "tests/support/fast_accelerometers.h"

namespace {

using namespace abcal;
using namespace std::chrono_literals;

constexpr Clock::Duration kStreamed = 10s;

void stream(benchmark::State& state, const AccelerometerDriver& driver) {
  for (auto _ : state) {
    test::EmulatedAccelerometer emulated(driver);
    Accelerometer& accelerometer = emulated.driver();
    accelerometer.start();
    const double cpu_before = emulated.cpu_seconds();
    const Clock::Instant begin = emulated.clock().now();
    std::int64_t readings = 0;
    while (emulated.clock().now() - begin < kStreamed) {
      if (accelerometer.next(emulated.clock().now() + 100ms)) ++readings;
    }
    const double seconds = to_seconds(emulated.clock().now() - begin);
    const double cpu = emulated.cpu_seconds() - cpu_before;
    const StreamHealth health = accelerometer.health();
    accelerometer.stop();
    state.counters["rate_hz"] = emulated.fast().rate_hz;
    state.counters["readings_per_s"] = static_cast<double>(readings) / seconds;
    state.counters["lost"] = static_cast<double>(health.lost_readings);
    state.counters["bad_frames"] = static_cast<double>(health.bad_frames);
    state.counters["cpu_percent_of_a_core"] = 100.0 * cpu / seconds;
    state.counters["us_per_reading"] = 1e6 * cpu / static_cast<double>(readings);
  }
}

}  // namespace

int main(int argc, char** argv) {
  std::string as_table = "--benchmark_counters_tabular=true";
  std::vector<char*> arguments(argv, argv + argc);
  arguments.insert(arguments.begin() + 1, as_table.data());
  int count = argc + 1;
  benchmark::Initialize(&count, arguments.data());
  if (benchmark::ReportUnrecognizedArguments(count, arguments.data())) return 1;
  for (const AccelerometerDriver& driver : accelerometer_drivers()) {
    benchmark::RegisterBenchmark(("BM_Stream/" + driver.name).c_str(), stream, driver)
        ->Iterations(1)
        ->Unit(benchmark::kSecond);
  }
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
