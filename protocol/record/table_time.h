#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// Seconds since 1970 of a time in ISO 8601, "2026-01-31T12:00:00.25Z" or with a blank for the T; without a
/// zone as if in UTC. Absent for any other text.
std::optional<double> seconds_of_iso(const std::string& text);

/// A unit in which the times of a series may count.
struct UnitOfTime {
  std::string_view name;  ///< "ms"
  double in_a_second = 1.0;
  std::array<std::string_view, 3> other_names;
};
inline constexpr std::array<UnitOfTime, 4> kUnitsOfTime{{{"s", 1.0, {"sec", "secs", "seconds"}},
                                                         {"ms", 1e3, {"msec", "millis", "milliseconds"}},
                                                         {"us", 1e6, {"usec", "micros", "microseconds"}},
                                                         {"ns", 1e9, {"nsec", "nanos", "nanoseconds"}}}};
/// The one that has this name, in small or capital letters; null: none.
const UnitOfTime* unit_of_time(std::string_view name);

/// How the times of a series count.
struct TimeUnit {
  std::string name;          ///< "ms"
  double in_a_second = 1.0;  ///< 1000
  std::string known_from;    ///< "from the spacing of 20", "since 1970"
};

/// The unit of the times of a series from their size, where they count from 1970, or from their median
/// spacing. Rates from 5 to 500 readings a second are likely, from 0.2 to 50 000 possible.
/// @param times  ascending, at least two
/// @return absent where several units are possible and not exactly one is likely
std::optional<TimeUnit> unit_from_spacing(const std::vector<double>& times);

/// Median of the differences of neighbours.
double median_spacing(const std::vector<double>& times);

}  // namespace abcal
