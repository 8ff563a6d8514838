#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "abcal/export.h"
#include "abcal/result.h"

namespace abcal::v1 {
/// An event of a run, as data: "run_began", "phase", "angle_begun", "dwell_done", "flag", "port_lost",
/// "port_back", "held", "continued", "notice", "all_measured", "finished".
struct Event {
  std::string name;
  std::string json;  ///< The complete event as one JSON object.
};

/// Called from the measuring thread; must return at once. If it throws, the stage is halted, the run file
/// stays resumable, and run() throws the same exception.
using Listener = std::function<void(const Event&)>;

/// One check of a bench and its outcome.
struct CheckFinding {
  std::string grade;   ///< "good", "warning", "problem", "left out"
  std::string what;    ///< "stage", "travel", "noise at rest", ...
  std::string found;   ///< In words, with units.
  std::string advice;  ///< Recommended action; empty: none.
};

/// A complete run and its results.
struct CompleteRun {
  std::filesystem::path file;
  std::string sha256;  ///< SHA-256 of the closed file.
  Result result;       ///< Result of the estimator chosen before the first angle.
  std::vector<Result> all_results;
};

/// The bench file of `abcal demo` as text, with the emulated instruments inside this program: a run on it
/// waits for nothing and takes less than a second.
/// @param steps  angles of each experiment, a divisor of 360
/// @throws std::invalid_argument
std::string demo_bench(int steps = 30);

/// A run was stopped; the stage was halted and the run file can be resumed.
class Stopped : public std::exception {
 public:
  explicit Stopped(std::string what) : what_(std::move(what)) {}
  ~Stopped() override;
  const char* what() const noexcept override { return what_.c_str(); }

 private:
  std::string what_;
};

/// A bench file and its instruments. The same class as behind the command line runs it: all foreseeable
/// errors are reported before the first move, each angle is on the disk before the stage moves on, a watchdog
/// and a guard process halt the stage.
///
/// One call of check(), run() or resume() at a time; hold(), go_on() and halt() from any thread.
class Bench {
 public:
  /// @throws std::runtime_error with every problem of the file
  explicit Bench(const std::filesystem::path& file);
  ~Bench();
  Bench(Bench&&) noexcept;
  Bench& operator=(Bench&&) noexcept;

  std::string name() const;
  std::string toml() const;                    ///< With every default written out.
  std::vector<std::string> warnings() const;   ///< Accepted, but unusual.
  std::vector<std::string> simulated() const;  ///< Those of "stage" and "accelerometer" that are simulated.

  /// Talks to both instruments, and turns both axes by 30 degrees.
  std::vector<CheckFinding> check(bool with_motion = true, const Listener& listener = {});

  /// Measures a new run to its end. @param run_file  to create; empty: BENCH-UTC.run here
  /// @throws Stopped after halt(); InstrumentError; std::runtime_error; exceptions of the listener
  CompleteRun run(const std::filesystem::path& run_file = {}, const Listener& listener = {});
  /// Continues an interrupted run to its end, with the bench file that is in it. @throws as run()
  CompleteRun resume(const std::filesystem::path& run_file, const Listener& listener = {});

  void hold();   ///< The stage stands still after the current angle.
  void go_on();  ///< After hold().
  /// Halts the stage at once and ends the run, which can be resumed. Waits for the answer to the halt.
  /// Does nothing if nothing runs.
  void halt();

 private:
  struct Data;
  std::unique_ptr<Data> data_;
};

}  // namespace abcal::v1
