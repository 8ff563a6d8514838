#pragma once

#include <array>
#include <filesystem>
#include <optional>

#include "app/bench_file/bench_config.h"
#include "app/results/planner/plan_prediction.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Properties of an axis known without asking the stage.
struct KnownAxis {
  AxisTravel travel;
  AxisSpeed speed;
  bool travel_assumed = false;
};

/// X and Z of a bench, as its file or its simulation says.
std::array<KnownAxis, 2> known_axes(const BenchConfig& config);

/// The item as a run found it. Its noise is the median over the angles and outputs.
/// @param result  with a sensitivity matrix
/// @throws std::invalid_argument if no mean has its uncertainty and number of readings
KnownItem known_item(const RunRecord& record, const CalibrationResult& result);

/// The item as found in a run's file, by ABC.
/// @param item  as load_record()
/// @throws std::invalid_argument also if it has no result; RunFileError, TableError
KnownItem item_of_run(const std::filesystem::path& run, int item = 0);

/// Noise of a simulated accelerometer, as in KnownItem; nothing: it is not simulated, or without noise.
std::optional<double> simulated_noise(const BenchConfig& config);

/// Input of predictions for this bench, with the record of the stage that it names, as old as it is now.
/// @throws std::runtime_error, std::invalid_argument  a record that cannot be read
PlanningBench planning_bench(const BenchConfig& config, const KnownItem& item);

}  // namespace abcal
