#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "app/commands/apply/apply_session.h"

namespace abcal {

/// The adjustment, made or only computed: registers, steps, errors as found and as predicted.
std::string apply_text(const ApplyReport& report);

/// The outcome of the adjustment: errors as found, predicted and left, and the state.
std::string outcome_text(const ApplyReport& report);

/// The whole report as JSON, schema `abcal.apply/1`.
nlohmann::ordered_json apply_json(const ApplyReport& report);

}  // namespace abcal
