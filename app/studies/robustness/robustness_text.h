#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "app/studies/robustness/robustness_study.h"

namespace abcal {

/// The table: one line for each scenario and estimator, shortfalls marked, then their number.
std::string robustness_text(const RobustnessStudy& study);

/// Schema abcal.robustness/1.
nlohmann::ordered_json robustness_json(const RobustnessStudy& study);

}  // namespace abcal
