#pragma once

#include <array>
#include <filesystem>
#include <optional>

#include "app/bench/bench_config.h"
#include "app/planner/plan_prediction.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {

/// What is known of an axis without asking the stage.
struct KnownAxis {
  AxisTravel travel;
  AxisSpeed speed;
  bool travel_assumed = false;
};

/// X and Z of a bench, as its file or its simulation says.
std::array<KnownAxis, 2> known_axes(const BenchConfig& config);

/// Standard deviation of one reading over the sensitivity: median over the angles and outputs of a run.
/// @throws std::invalid_argument if the file has no such means; RunFileError, CsvError
double noise_of_run(const std::filesystem::path& run);

/// The same of a simulated accelerometer; nothing: it is not simulated, or without noise.
std::optional<double> simulated_noise(const BenchConfig& config);

/// What predictions of this bench begin with.
PlanningBench planning_bench(const BenchConfig& config, double noise);

}  // namespace abcal
