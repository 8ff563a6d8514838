#include "protocol/plan/series_leg.h"

#include "drivers/text/names.h"

namespace abcal {

constexpr auto kLegs = names<SeriesLeg>({{SeriesLeg::kReference, "reference"},
                                         {SeriesLeg::kUp, "up"},
                                         {SeriesLeg::kDown, "down"},
                                         {SeriesLeg::kReturn, "return"}});

std::string_view to_string(SeriesLeg leg) {
  return kLegs.of(leg);
}

std::optional<SeriesLeg> series_leg_from(std::string_view word) {
  return kLegs.value(word);
}

}  // namespace abcal
