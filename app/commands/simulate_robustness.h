#pragma once

#include "app/studies/robustness/robustness_study.h"

namespace abcal {

/// `abcal simulate robustness`: runs the study and prints its table or JSON.
/// @return the exit code
int simulate_robustness(const RobustnessOptions& options, bool json);

}  // namespace abcal
