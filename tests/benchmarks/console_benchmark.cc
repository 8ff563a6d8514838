// Cost of watching: a run in real time (the emulator in a process of its own, over pseudo-terminals, the
// console in another) with nobody watching and with 50 pages, one of which never reads; the memory of the
// console; and the time from an angle in the measuring thread to a page.

#include <benchmark/benchmark.h>
#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <regex>
#include <thread>
#include <vector>

#include "protocol/record/run_file.h"
#include "tests/console/client.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace {

using namespace abcal;
using namespace std::chrono_literals;
using Json = nlohmann::json;

constexpr int kWatching = 50;
constexpr int kRuns = 3;  // each way, in turn

const char* const kBench =
    "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"links/stage\"\n"
    "[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"links/accelerometer\"\nrate_hz = 500.0\n"
    "[protocol]\nsteps = 12\nstep_deg = 5.0\nsettle_s = 0.1\ndwell_readings = 100\nclosing_angle = "
    "false\ncheck_poses = false\n"
    "[simulation]\nnoise = 1e-4\n"
    "[simulation.x]\nspeed_deg_per_s = 100.0\nacceleration_deg_per_s2 = 2000.0\n"
    "[simulation.z]\nspeed_deg_per_s = 100.0\nacceleration_deg_per_s2 = 2000.0\n";

/// Emulator and console.
class ServedBench {
 public:
  ServedBench() {
    test::write_file(folder / "bench.toml", kBench);
    emulator.emplace(std::vector<std::string>{"emulate", "bench.toml", "--link-dir", "links"}, folder.path());
    if (!test::wait_for([&] { return std::filesystem::exists(folder / "links/accelerometer"); }, 20s))
      throw std::runtime_error("the emulator did not start: " + emulator->err());
    server.emplace(std::vector<std::string>{"serve", "bench.toml", "--port", "0"}, folder.path());
    std::smatch found;
    std::string said;
    if (!test::wait_for(
            [&] {
              said = server->out();
              return std::regex_search(said, found, std::regex("Console: http://127.0.0.1:(\\d+)/"));
            },
            20s))
      throw std::runtime_error("the console did not start: " + server->err());
    port = static_cast<std::uint16_t>(std::stoi(found[1]));
  }

  /// kB, from /proc: "VmRSS" or "VmHWM".
  double memory_kb(const std::string& key) const {
    std::ifstream status("/proc/" + std::to_string(server->pid()) + "/status");
    for (std::string line; std::getline(status, line);)
      if (line.starts_with(key + ":")) return std::stod(line.substr(key.size() + 1));
    return 0.0;
  }

  /// @return duration of the run by its own account, s.
  double run(test::PageClient& page) {
    const Json begun = page.ask({{"do", "start"}, {"confirmed", true}});
    if (!begun["ok"].get<bool>()) throw std::runtime_error("no run was started: " + begun.dump());
    Json ended;
    const auto end = std::chrono::steady_clock::now() + 5min;
    while (ended.is_null()) {
      const auto message = page.next(end);
      if (!message) throw std::runtime_error("the run did not end");
      if ((*message)["type"] == "finished") ended = *message;
    }
    if (!ended["complete"].get<bool>()) throw std::runtime_error(ended.dump());
    page.wait_for_activity("idle");
    return RunFile::load(folder / ended["file"].get<std::string>()).timing.total_s();
  }

  test::TemporaryFolder folder;
  std::optional<test::Program> emulator, server;
  std::uint16_t port = 0;
};

/// Pages that read all they are sent, in a thread of their own, and one that never does.
class Watchers {
 public:
  explicit Watchers(std::uint16_t port)
      : deaf_(std::make_unique<test::PageClient>(port, test::Headers{}, "/live", 4096)) {
    for (int i = 0; i < kWatching - 1; ++i) pages_.push_back(std::make_unique<test::PageClient>(port));
    thread_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        for (auto& page : pages_)
          while (const auto message = page->next(std::chrono::steady_clock::now())) look(*message);
        std::this_thread::sleep_for(2ms);
      }
    });
  }
  ~Watchers() { thread_ = {}; }

  /// From the measuring thread to a page, ms.
  std::vector<double> delays_ms() {
    const std::lock_guard lock(mutex_);
    return delays_ms_;
  }

 private:
  void look(const Json& message) {
    if (message["type"] != "dwell_done") return;
    const auto now = std::chrono::floor<std::chrono::microseconds>(std::chrono::system_clock::now());
    const std::lock_guard lock(mutex_);
    delays_ms_.push_back(
        1e-3 * static_cast<double>(now.time_since_epoch().count() - message["told_us"].get<std::int64_t>()));
  }

  std::unique_ptr<test::PageClient> deaf_;
  std::vector<std::unique_ptr<test::PageClient>> pages_;
  std::mutex mutex_;
  std::vector<double> delays_ms_;
  std::jthread thread_;
};

double quantile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0.0 : values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

void BM_FiftyPagesWatch(benchmark::State& state) {
  for (auto _ : state) {
    ServedBench bench;
    test::PageClient page(bench.port);
    page.wait_for_type("snapshot");  // The process that holds the bench has started.
    page.ok({{"do", "control"}});
    bench.run(page);  // A first run loads everything into memory.
    const double before_kb = bench.memory_kb("VmRSS");
    std::vector<double> alone, watched, delays;
    for (int i = 0; i < kRuns; ++i) {
      alone.push_back(bench.run(page));
      Watchers watchers(bench.port);
      watched.push_back(bench.run(page));
      const std::vector<double> more = watchers.delays_ms();
      delays.insert(delays.end(), more.begin(), more.end());
    }
    state.counters["alone_s"] = quantile(alone, 0.5);
    state.counters["watched_s"] = quantile(watched, 0.5);
    state.counters["ratio"] = quantile(watched, 0.5) / quantile(alone, 0.5);
    state.counters["more_memory_mb"] = (bench.memory_kb("VmHWM") - before_kb) / 1024.0;
    state.counters["delay_median_ms"] = quantile(delays, 0.5);
    state.counters["delay_99_percent_ms"] = quantile(delays, 0.99);
    state.counters["messages"] = static_cast<double>(delays.size());
  }
}
BENCHMARK(BM_FiftyPagesWatch)->Iterations(1)->Unit(benchmark::kSecond);

}  // namespace

BENCHMARK_MAIN();
