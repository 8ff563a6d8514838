#pragma once

#include <optional>
#include <string_view>

namespace abcal {

/// The place of a point in a series.
enum class SeriesLeg { kReference, kUp, kDown, kReturn };
std::string_view to_string(SeriesLeg leg);
/// @return nullopt for any other word
std::optional<SeriesLeg> series_leg_from(std::string_view word);

}  // namespace abcal
