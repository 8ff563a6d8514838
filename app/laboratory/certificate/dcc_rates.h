#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/stated_result.h"
#include "app/laboratory/certificate/words.h"

namespace abcal {

/// Unit of a rate, in D-SI.
inline constexpr const char* kDegreesPerSecond = "\\degree\\second\\tothe{-1}";

/// Adds the response at each rate of a run at a constant rate: frequency, amplitude relative to rest, phase
/// beyond a delay (docs/constant_rate.md). Nothing for a run in steps.
/// @throws NumberNotFinite
void add_response_at_rates(XmlElement& results, const Words& words, const StatedResult& stated);

}  // namespace abcal
