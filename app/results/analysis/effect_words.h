#pragma once

#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// Whether a sentence also says where in the bench file the operator mends what it found. A result, and with
/// it a certificate, has none: its reader has no bench file.
enum class Advice { kNone, kForOperator };

/// A sentence that names the effects whose size is a default; empty if all sizes are stated.
Message default_effects_words(const EffectSizes& sizes, Advice advice);

/// A sentence about each effect that benches usually have, that was not stated and whose default is zero: the
/// uncertainty does not cover it.
std::vector<Message> uncovered_effects_words(const EffectSizes& sizes, Advice advice);

/// Words of the effects whose size was stated as a number alone, without saying where it comes from. Sizes of
/// zero leave their effect out and need no source.
std::vector<Message> effects_without_source(const EffectSizes& sizes);

/// The notes of a result without those that its reason repeats, and without those on effects that were not
/// stated: a summary says what these cost, and a report which they are.
std::vector<Message> further_notes(const CalibrationResult& result, const EffectSizes& sizes);

}  // namespace abcal
