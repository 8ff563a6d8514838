#pragma once

#include <string>

namespace abcal {

/// The bytes of a MATLAB file (version 5) with the members of M, b and the rest as variables of their own.
/// @param constants_json  schema abcal.constants/1 or abcal.temperature_constants/1
/// @throws ProgramMissing without abcal-mat, std::runtime_error with its words
std::string as_mat(const std::string& constants_json);

}  // namespace abcal
