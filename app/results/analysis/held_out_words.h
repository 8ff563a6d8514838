#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "protocol/estimators/joint/held_out_norm.h"

namespace abcal {

/// |a| on poses held out of the fit, what is expected, and what the check cannot see, in sentences.
Message held_out_words(const HeldOutNorm& norm);

/// The same as members of an object.
nlohmann::ordered_json held_out_json(const HeldOutNorm& norm);

}  // namespace abcal
