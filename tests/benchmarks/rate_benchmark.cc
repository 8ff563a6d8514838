// A tray at factory rates over pseudo-terminals in real time: `abcal emulate` and `abcal run` in processes of
// their own, about ten minutes each. Needs two processors without other work. Stored times are compared with
// the emulator's, whose samples are even by the same clock of this computer.

#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>

#include "protocol/record/run_file.h"
#include "protocol/record/sqlite.h"
#include "tests/support/processor_time.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace {

using namespace abcal;

struct Tray {
  int items = 0;
  int rate_hz = 0;
  int steps = 60;
  double dwell_s = 2.0;
};

/// @param wired  with the links of the emulator as ports
std::string bench(const Tray& tray, bool wired) {
  const auto port = [&](const std::string& name) { return wired ? "links/" + name : "simulated"; };
  std::string text = fmt::format(
      "schema = \"abcal.bench/2\"\n"
      "[bench]\nname = \"rates\"\ng_loc_mps2 = 9.80101\n"
      "[stage]\ndriver = \"pi_gcs\"\nport = \"{}\"\n"
      "[emulator]\nline = \"ideal\"\n"
      "[protocol]\nsteps = {}\nstep_deg = {}\nsettle_s = 0.5\ndwell_readings = {}\n"
      "[simulation]\nnoise = 1e-4\nquantisation = 1e-6\n"
      "[simulation.x]\nspeed_deg_per_s = 90.0\nacceleration_deg_per_s2 = 400.0\n"
      "[simulation.z]\nspeed_deg_per_s = 90.0\nacceleration_deg_per_s2 = 400.0\n",
      port("stage"), tray.steps, 360.0 / tray.steps, static_cast<int>(tray.dwell_s * tray.rate_hz));
  for (int k = 1; k <= tray.items; ++k) {
    text += fmt::format(
        "[[item]]\nserial_number = \"B-{:03}\"\n[item.accelerometer]\ndriver = \"text_line\"\nport = \"{}\"\n"
        "rate_hz = {}\n",
        k, port("item-" + std::to_string(k)), tray.rate_hz);
  }
  return text;
}

struct Found {
  double readings = 0.0;  ///< All that were streamed, stored or not.
  double stored = 0.0;    ///< Rows.
  double lost = 0.0;
  double dropped_items = 0.0;
  double worst_time_s = 0.0;  ///< Largest difference between a stored time and the item's true one.
  double worst_dwell = 0.0;   ///< Largest relative difference of the length of a dwell from the nominal one.
};

Found look_at(const std::filesystem::path& run, const Tray& tray) {
  Found found;
  SqliteDatabase database(run, SqliteDatabase::Mode::kReadOnly);
  for (int item = 1; item <= tray.items; ++item) {
    double earliest_s = std::numeric_limits<double>::infinity(), latest_s = -earliest_s;
    std::int64_t last_sequence = -1;
    RunFile::read_dwells(
        run,
        [&](const StoredDwell& dwell) {
          if (dwell.readings.empty()) return;
          const StoredReading& first = dwell.readings.front();
          const StoredReading& last = dwell.readings.back();
          const double nominal_s = static_cast<double>(last.sequence - first.sequence) / tray.rate_hz;
          found.worst_dwell =
              std::max(found.worst_dwell, std::abs((last.time_s - first.time_s) / nominal_s - 1.0));
          for (const StoredReading& reading : dwell.readings) {
            const double late_s = reading.time_s - static_cast<double>(reading.sequence) / tray.rate_hz;
            earliest_s = std::min(earliest_s, late_s);
            latest_s = std::max(latest_s, late_s);
          }
          last_sequence = std::max(last_sequence, static_cast<std::int64_t>(last.sequence));
          found.stored += static_cast<double>(dwell.readings.size());
        },
        item);
    found.readings += static_cast<double>(last_sequence + 1);
    found.worst_time_s = std::max(found.worst_time_s, latest_s - earliest_s);
  }
  found.lost = std::stod(database.value("select sum(lost) from dwell").value_or("0"));
  if (database.has_table("item_drop"))
    found.dropped_items = std::stod(database.value("select count(*) from item_drop").value_or("0"));
  return found;
}

void rates(benchmark::State& state) {
  const Tray tray{static_cast<int>(state.range(0)), static_cast<int>(state.range(1))};
  for (auto _ : state) {
    const test::TemporaryFolder folder;
    test::write_file(folder / "emulated.toml", bench(tray, false));
    test::write_file(folder / "bench.toml", bench(tray, true));
    const test::Program emulator({"emulate", "emulated.toml", "--link-dir", "links"}, folder.path());
    if (!test::wait_for([&] { return emulator.out().find("Serving") != std::string::npos; },
                        std::chrono::seconds(60)))
      return state.SkipWithError("the emulator does not serve");
    const double cpu_before_s = test::processor_seconds(RUSAGE_CHILDREN);
    test::Program run({"run", "bench.toml", "-o", "a.run"}, folder.path());
    run.wait();
    const double cpu_s = test::processor_seconds(RUSAGE_CHILDREN) - cpu_before_s;
    if (!std::filesystem::exists(folder / "a.run") ||
        RunFile::load(folder / "a.run").state != RunState::kComplete)
      return state.SkipWithError(run.err().c_str());
    const Found found = look_at(folder / "a.run", tray);
    state.counters["measured_s"] = RunFile::load(folder / "a.run").timing.total_s();
    state.counters["lost"] = found.lost;
    state.counters["items_left_out"] = found.dropped_items;
    state.counters["worst_time_ms"] = 1e3 * found.worst_time_s;
    state.counters["worst_dwell_percent"] = 100.0 * found.worst_dwell;
    // With the analysis at the end.
    state.counters["cpu_us_per_reading"] = 1e6 * cpu_s / found.readings;
    state.counters["bytes_per_reading"] =
        static_cast<double>(std::filesystem::file_size(folder / "a.run")) / found.stored;
  }
}
BENCHMARK(rates)
    ->ArgNames({"items", "rate_hz"})
    ->Args({32, 1000})
    ->Args({8, 4000})
    ->Iterations(1)
    ->UseRealTime()
    ->Unit(benchmark::kSecond);

}  // namespace

BENCHMARK_MAIN();
