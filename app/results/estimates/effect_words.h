#pragma once

#include <string>
#include <vector>

#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// A sentence that names the effects whose size is a default; empty if all sizes are stated.
std::string default_effects_words(const EffectSizes& sizes);

/// A sentence about each effect that benches usually have, that was not stated and whose default is zero: the
/// uncertainty does not cover it.
std::vector<std::string> uncovered_effects_words(const EffectSizes& sizes);

/// Words of the effects whose size was stated as a number alone, without saying where it comes from. Sizes of
/// zero leave their effect out and need no source.
std::vector<std::string> effects_without_source(const EffectSizes& sizes);

}  // namespace abcal
