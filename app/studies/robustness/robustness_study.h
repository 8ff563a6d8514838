#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <stop_token>
#include <string>
#include <vector>

#include "app/studies/robustness/scenario.h"
#include "protocol/record/run_record.h"
#include "sim/sim_bench.h"

namespace abcal {

/// Groups of outputs: s diagonal, s off-diagonal, O, intrinsic s, phi.
inline constexpr std::size_t kOutputGroups = 5;
/// "s diagonal", ...
const std::array<std::string, kOutputGroups>& output_group_names();

struct RobustnessOptions {
  int benches = 200;                   ///< Number of benches for each scenario.
  std::vector<std::string> scenarios;  ///< Names; empty: all.
  std::vector<std::string> estimators{"abc", "joint"};
  std::uint64_t seed = 1;
  int threads = 1;
  std::stop_token stop;
  std::function<void(int done, int planned)> progress;  ///< Called by one thread at a time.
};

/// One group of outputs over the runs that were called usable.
struct GroupCoverage {
  double coverage = std::numeric_limits<double>::quiet_NaN();   ///< Share of 95 % intervals with the truth.
  double rms_error = std::numeric_limits<double>::quiet_NaN();  ///< R/g_loc, R or degree.
  double rms_u = std::numeric_limits<double>::quiet_NaN();      ///< Root mean square of the stated u.
  double ratio() const { return rms_error / rms_u; }
};

struct ScenarioOutcome {
  std::string scenario, words, estimator;
  ScenarioKind kind = ScenarioKind::kWithin;
  int runs = 0, usable = 0, doubtful = 0, not_usable = 0;
  std::array<GroupCoverage, kOutputGroups> groups;
  /// Root mean square of the stated u of each output: s row by row, O, intrinsic s, phi. Empty: no usable
  /// run.
  std::vector<double> rms_u_of_output;

  double usable_share() const { return static_cast<double>(usable) / runs; }
  /// Requirements of the scenario's kind that the outcome does not meet, in words; empty: none.
  std::vector<std::string> shortfalls() const;
};

struct RobustnessStudy {
  int benches = 0;
  std::uint64_t seed = 0;
  bool interrupted = false;
  std::vector<ScenarioOutcome> outcomes;  ///< Scenario by scenario, estimators in their order.
};

/// Limits of ScenarioOutcome::shortfalls().
inline constexpr double kLeastCoverage = 0.92;
inline constexpr double kLeastUsable = 0.80;
inline constexpr double kMostUsableWhenWrong = 0.05;

/// A run on a bench at the level of angles, with the readings of the simulated world at the middle of each
/// dwell.
struct SimulatedRun {
  RunRecord record;
  sim::TrueLineResponse truth;  ///< Mean over the times of the angles.
};
SimulatedRun simulate_run(const ScenarioBench& bench);

/// Simulates and analyses every bench of every scenario. The same for any number of threads.
/// @throws std::invalid_argument an unknown scenario, no benches, no threads
RobustnessStudy run_robustness_study(const RobustnessOptions& options);

}  // namespace abcal
