#include "protocol/plan/series_leg.h"

#include <algorithm>
#include <array>
#include <utility>

namespace abcal {
namespace {

constexpr std::array<std::pair<SeriesLeg, std::string_view>, 4> kLegs{{{SeriesLeg::kReference, "reference"},
                                                                       {SeriesLeg::kUp, "up"},
                                                                       {SeriesLeg::kDown, "down"},
                                                                       {SeriesLeg::kReturn, "return"}}};

}  // namespace

std::string_view to_string(SeriesLeg leg) {
  return std::find_if(kLegs.begin(), kLegs.end(), [&](const auto& each) { return each.first == leg; })
      ->second;
}

std::optional<SeriesLeg> series_leg_from(std::string_view word) {
  for (const auto& [leg, name] : kLegs)
    if (name == word) return leg;
  return std::nullopt;
}

}  // namespace abcal
