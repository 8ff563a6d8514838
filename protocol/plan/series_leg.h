#pragma once

#include <optional>
#include <string_view>

namespace abcal {

/// Where a point stands in a series.
enum class SeriesLeg { kReference, kUp, kDown, kReturn };
std::string_view to_string(SeriesLeg leg);
/// @return nothing for a word that is none of them
std::optional<SeriesLeg> series_leg_from(std::string_view word);

}  // namespace abcal
