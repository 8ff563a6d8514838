#pragma once

#include <filesystem>

#include "protocol/uncertainty/type_b.h"

namespace abcal {

/// An accelerometer from a file: JSON with `sensitivity_matrix` (3x3, rows u v w) and `offset`, as plain
/// numbers or as quantities with `value` (so the output of `abcal analyse --json` will do); or text of 12
/// numbers, s row by row, then O.
/// @throws std::invalid_argument naming the problem of the file
AccelerometerUnderTest read_accelerometer(const std::filesystem::path& path);

}  // namespace abcal
