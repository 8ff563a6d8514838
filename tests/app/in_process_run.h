#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <string_view>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/measure/bench/make_bench.h"

namespace abcal::test {

/// Does the work of `abcal run` and `abcal resume` on a simulated bench inside the test, so that the test can
/// come between the run, its instruments and its disk.
class InProcessRun {
 public:
  InProcessRun(std::string bench_toml, std::filesystem::path path)
      : bench_toml_(std::move(bench_toml)), path_(std::move(path)) {}

  /// Begins the run, or resumes it, and takes it to its end: closed and analysed. Does nothing if it already
  /// is.
  /// @throws the exceptions of the commands
  void run_to_end();

  bool exists() const { return std::filesystem::exists(path_); }
  const std::filesystem::path& path() const { return path_; }

  /// Called before each call to an instrument except halt() and stop(), with its name and its number in this
  /// run_to_end() (1 is the first); may throw the exceptions of the instrument.
  std::function<void(std::string_view call, std::size_t number)> before_call;
  /// May change the bench before it is made, e.g. its faults this time.
  std::function<void(BenchConfig& config)> change_bench;

  // Figures of the last run_to_end().
  std::size_t calls() const { return calls_; }
  std::size_t halts() const { return halts_; }
  /// Whether an axis was commanded to move, and neither came to rest nor was halted before the run ended.
  bool left_moving() const { return left_moving_; }
  double simulated_s() const { return simulated_s_; }
  /// The longest simulated time from one angle that was reported as measured (or the begin) to the next (or
  /// the end), in seconds.
  double longest_angle_s() const { return longest_angle_s_; }
  const std::optional<RunOutcome>& finished() const { return finished_; }

  /// The angles that all run_to_end() together have reported as measured: positions in the plan.
  const std::set<std::size_t>& reported() const { return reported_; }

 private:
  class WatchedStage;
  class WatchedAccelerometer;
  void watch(Bench& bench);
  void before(std::string_view call);

  std::string bench_toml_;
  std::filesystem::path path_;
  std::size_t calls_ = 0, halts_ = 0;
  bool left_moving_ = false;
  double simulated_s_ = 0.0, longest_angle_s_ = 0.0;
  std::optional<RunOutcome> finished_;
  std::set<std::size_t> reported_;
};

}  // namespace abcal::test
