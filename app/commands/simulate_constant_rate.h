#pragma once

#include "app/studies/constant_rate/constant_rate_study.h"

namespace abcal {

/// `abcal simulate constant-rate`: runs the study and prints it.
/// @return exit code: failed where a bench has no solution, or an uncertainty misses the figure of its design
int simulate_constant_rate(const ConstantRateOptions& options, bool json);

}  // namespace abcal
