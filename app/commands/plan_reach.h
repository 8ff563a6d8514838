#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "app/bench_file/bench_config.h"
#include "app/results/planner/plan_prediction.h"

namespace abcal {

/// Options of the search for a plan (`--reach`, `--time`) in `abcal plan` and `abcal temperature`.
struct ReachOptions {
  std::string bench_file;
  std::string reach;  ///< "phi=1e-3 deg, s=2e-5"; empty: the paper's uncertainties, as a scale for --time.
  std::string time;   ///< "10min"; empty: the shortest plan that reaches the wanted uncertainties.
  std::string
      noise;  ///< Standard deviation of one reading in g_loc, or a run or CSV; empty: of [simulation].
  std::string estimator;  ///< Empty: that of the bench file.
  std::string plot;       ///< SVG to write: uncertainty against time.
  bool others = false;    ///< Print too what other times give; --plot does.
  bool write = false;     ///< Put the plan into the bench file.
  bool json = false;

  bool asked() const { return !reach.empty() || !time.empty(); }
  /// Something that goes with --reach or --time was given.
  bool has_details() const {
    return !noise.empty() || !estimator.empty() || !plot.empty() || others || write;
  }
};

/// Adds --reach, --time and --noise.
void add_question_options(CLI::App& command, ReachOptions& options);
/// Adds the question options, --estimator, --others, --plot and --write.
void add_reach_options(CLI::App& command, ReachOptions& options);

/// The given --reach, --time and --noise in one line: "reach s=1e-5, noise 1e-4". Empty: none given.
std::string question_words(const ReachOptions& options);

/// The plan that the options request.
/// @throws std::invalid_argument  an invalid value; unknown noise
/// @throws std::runtime_error  out of reach, with the reason
PlanPrediction find_plan(const ReachOptions& options, const BenchConfig& config);

/// Finds the plan and prints it.
/// @param bench  without its noise
/// @return the exit code of the program: 1 if the wanted uncertainties cannot be reached
int run_reach(const ReachOptions& options, PlanningBench bench);

}  // namespace abcal
