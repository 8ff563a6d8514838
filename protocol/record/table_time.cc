#include "protocol/record/table_time.h"

#include <fmt/format.h>

#include <time.h>

#include <algorithm>
#include <array>
#include <cstddef>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal {

const UnitOfTime* unit_of_time(std::string_view name) {
  const std::string letters = pieces::lower(name);
  const auto found = std::ranges::find_if(kUnitsOfTime, [&](const UnitOfTime& unit) {
    return unit.name == letters || std::ranges::count(unit.other_names, letters) > 0;
  });
  return found == kUnitsOfTime.end() ? nullptr : &*found;
}

std::optional<double> seconds_of_iso(const std::string& text) {
  // Days of dates differ by their numbers alone, in whichever order day and month stand.
  constexpr std::array kFormats{"%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S", "%Y/%m/%d %H:%M:%S",
                                "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%d/%m/%Y %H:%M:%S",
                                "%H:%M:%S"};
  if (text.size() < 7 || text.find(':') == std::string::npos) return std::nullopt;
  tm parts{};
  const char* rest = nullptr;
  for (const char* format : kFormats) {
    parts = {};
    parts.tm_year = 70;
    parts.tm_mday = 1;
    if ((rest = strptime(text.c_str(), format, &parts)) != nullptr) break;
  }
  if (rest == nullptr) return std::nullopt;
  double fraction = 0.0;
  if (*rest == '.' || *rest == ',') {
    const char* end = ++rest;
    while (pieces::is_digit(*end)) ++end;
    const auto found = pieces::number<double>("0." + std::string(rest, end));
    if (!found) return std::nullopt;
    fraction = *found;
    rest = end;
  }
  const double since_1970 = static_cast<double>(timegm(&parts)) + fraction;
  if (*rest == '\0') return since_1970;
  tm zone{};
  const char* end = strptime(rest, "%z", &zone);
  if (end == nullptr || *end != '\0') return std::nullopt;
  return since_1970 - static_cast<double>(zone.tm_gmtoff);
}

double median_spacing(const std::vector<double>& times) {
  std::vector<double> spacing(times.size() - 1);
  for (std::size_t i = 0; i < spacing.size(); ++i) spacing[i] = times[i + 1] - times[i];
  const auto middle = spacing.begin() + static_cast<std::ptrdiff_t>(spacing.size() / 2);
  std::ranges::nth_element(spacing, middle);
  return *middle;
}

std::optional<TimeUnit> unit_from_spacing(const std::vector<double>& times) {
  const double spacing = median_spacing(times);
  const auto units_with_rate = [&](double least, double most) {
    std::vector<UnitOfTime> found;
    for (const UnitOfTime& unit : kUnitsOfTime)
      if (const double rate = unit.in_a_second / spacing; rate >= least && rate <= most)
        found.push_back(unit);
    return found;
  };
  // The years 1973 to 2286.
  for (const UnitOfTime& unit : units_with_rate(0.2, 50'000.0))
    if (times.front() > 1e8 * unit.in_a_second && times.front() < 1e10 * unit.in_a_second)
      return TimeUnit{std::string(unit.name), unit.in_a_second, "since 1970"};
  std::vector<UnitOfTime> found = units_with_rate(5.0, 500.0);
  if (found.size() != 1) found = units_with_rate(0.2, 50'000.0);
  if (found.size() != 1) return std::nullopt;
  return TimeUnit{std::string(found.front().name), found.front().in_a_second,
                  fmt::format("from the spacing of {:.3g}", spacing)};
}

}  // namespace abcal
