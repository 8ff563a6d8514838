#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>

#include "protocol/uncertainty/type_a.h"

namespace abcal {

/// `abcal uncertainty RUN|FILE.csv`: type B, type A, budget and both combined. Bad options throw
/// std::invalid_argument.
CLI::App* add_uncertainty(CLI::App& parent, int& exit_code);

/// Measured errors of the calibration system from the JSON of a joint analysis (`abcal analyse RUN
/// --estimator joint
/// --json`): alignment, initial_turn_error, mean_step_error and step_error, each with value and
/// standard_uncertainty.
/// @throws std::invalid_argument saying what is wrong with the file
MeasuredAcs read_measured_acs(const std::filesystem::path& path);

}  // namespace abcal
