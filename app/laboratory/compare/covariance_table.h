#pragma once

#include <filesystem>

#include "app/laboratory/compare/compared_result.h"

namespace abcal {

/// Whether a file begins like a table of quantities with their covariance: comments "# key: value", then a
/// line "quantity,value,...".
bool looks_like_covariance_table(const std::filesystem::path& path);

/// Reads a result as a table (docs/pilot.md): a line for each of the nine quantities with its value and its
/// row of the covariance, columns in the order of kIntrinsicSymbols. Sensitivities are per m/s2, angles in
/// degrees, offsets in the response unit, which a comment "# response_unit: V" states; quantities that are
/// left out are not given.
/// @throws std::runtime_error with all problems of the file
ComparedResult read_covariance_table(const std::filesystem::path& path);

}  // namespace abcal
