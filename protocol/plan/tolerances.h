#pragma once

#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// The name of bench/1 and of the published protocol for the sizes of the effects.
using Tolerances = EffectSizes;

}  // namespace abcal
