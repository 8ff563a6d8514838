#pragma once

#include <string>

#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// A sentence that names the effects whose size is a default; empty if there are none.
std::string default_effects_words(const EffectSizes& sizes);

}  // namespace abcal
