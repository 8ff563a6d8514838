#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <filesystem>

#include "protocol/uncertainty/type_b.h"

namespace abcal {

/// `abcal simulate SET`: the paper's simulations. Bad options throw std::invalid_argument.
CLI::App* add_simulate(CLI::App& parent, int& exit_code);

/// A count from the command line. (CLI11 takes "-3" for an unsigned number and wraps it.)
/// @throws std::invalid_argument naming the option if it is negative
std::uint64_t not_negative(const char* option, std::int64_t value);

/// An accelerometer from a file: JSON with `sensitivity_matrix` (3x3, rows u v w) and `offset`, as plain
/// numbers or as quantities with `value` (so the output of `abcal analyse --json` will do); or text of 12
/// numbers, s row by row, then O.
/// @throws std::invalid_argument saying what is wrong with the file
AccelerometerUnderTest read_accelerometer(const std::filesystem::path& path);

}  // namespace abcal
