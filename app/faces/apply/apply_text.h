#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "app/faces/apply/apply_session.h"

namespace abcal {

/// What would be written, or was: registers, steps, errors as found and as they are to be.
std::string apply_text(const ApplyReport& report);

/// What became of it: errors as left beside those before, and the state.
std::string outcome_text(const ApplyReport& report);

/// `abcal.apply/1`: all of it.
nlohmann::ordered_json apply_json(const ApplyReport& report);

}  // namespace abcal
