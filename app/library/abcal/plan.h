#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "abcal/export.h"

namespace abcal::v1 {
/// A plan of the three experiments with the predicted uncertainties of its result.
struct PredictedPlan {
  int steps = 0;  ///< Angles of each experiment.
  double step_deg = 0.0;
  int dwell_readings = 0;
  std::string estimator;
  double moving_s = 0.0, settling_s = 0.0, dwelling_s = 0.0;
  double duration_s() const { return moving_s + settling_s + dwelling_s; }
  /// Predicted standard uncertainties of the worst output of each group: "s" and "off" relative to the
  /// sensitivity, "O" in g_loc, "phi" in degrees.
  std::map<std::string, double> u;
  std::map<std::string, std::string>
      largest_part;  ///< Largest part of each group: "noise of the readings", "wobble of X", ...
  /// Empty: in steps. Otherwise the stage turns at these rates, up and down in turn, and `steps` divide each
  /// sweep.
  std::vector<double> rate_deg_per_s;
  int sweeps = 0;  ///< Sweeps of each circle, at a constant rate.
};

struct PlanQuestion {
  /// Wanted standard uncertainties: "s=2e-5, off=2e-4, O=5e-5, phi=1e-3 deg"; empty: the paper's type B.
  std::string reach = {};
  double within_s = 0.0;                       ///< > 0: the best plan that takes at most this time.
  std::optional<double> noise = std::nullopt;  ///< Standard deviation of one reading in g_loc.
  std::filesystem::path noise_of = {};  ///< Instead: an earlier run, which gives angles and offsets as well.
  std::string estimator = {};           ///< Instead of the bench file's: "abc", "joint".
};

struct PlanAnswer {
  std::optional<PredictedPlan> plan;
  std::vector<std::string> out_of_reach;  ///< Reasons if no plan is found.
};

/// The shortest plan that reaches the wanted uncertainties, or the best one in a given time, as `abcal plan
/// --reach` finds it.
/// @throws std::runtime_error for a bench file that cannot be used, with all its problems;
/// std::invalid_argument
PlanAnswer plan(const std::filesystem::path& bench_file, const PlanQuestion& question = {});

/// Predicts one plan. @throws as plan()
PredictedPlan predict(const std::filesystem::path& bench_file, int steps, int dwell_readings,
                      const PlanQuestion& question = {});

}  // namespace abcal::v1
