#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <string>

#include "app/bench_file/level_file.h"
#include "protocol/estimators/circle/level_estimator.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The result of a levelling.
struct Levelling {
  TiltOfZ tilt;
  XZero x_zero;
};

/// The sensitivity by which a levelling is evaluated (R per g_loc): the nominal one of the output's unit;
/// nullopt if the unit does not imply one.
std::optional<Eigen::Matrix3d> nominal_sensitivity(const std::string& output_unit, double g_loc_mps2);

/// Evaluates the complete readings of level_plan().
Levelling evaluate_levelling(const StoredRun& run, const Eigen::Matrix3d& sensitivity);

/// The file for `level_file` in a bench file.
LevelFile level_file_of(const Levelling& levelling, const StoredRun& run);

}  // namespace abcal
