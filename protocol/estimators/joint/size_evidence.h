#pragma once

#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/estimators/joint/noise_search.h"

namespace abcal {

/// How much better a larger size of the effects of one key explains the readings, key by key, and of the step
/// errors without memory, alone and with the smooth ones. A noise process can take the place of effects that
/// are larger than stated; then no estimate of an effect shows it, but the readings are far more probable
/// with the larger effect and less noise.
std::vector<SizeEvidence> size_evidence(const EffectModel& model, const NoiseSearch& search);

}  // namespace abcal
