#include "protocol/run/sampling_times.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "protocol/statistics/median.h"

namespace abcal {
namespace {

constexpr std::size_t kLeastReadings = 16;
/// Number of parts of a dwell, and how many of them need no reading near the line.
constexpr std::size_t kParts = 8;
constexpr std::ptrdiff_t kPartsWithout = 2;
constexpr double kNearNs = 0.5e6;
/// Time in which the clock of an instrument runs evenly, to some 0.01 ms.
constexpr Clock::Duration kClockSpan = std::chrono::minutes(2);
/// Length of the parts of that time whose least delays determine the clock.
constexpr double kPartNs = 1e9;
constexpr double kMostChangeNs = 0.2e6;

/// A reading: its number and its arrival in nanoseconds, from those of the first one.
struct Point {
  double number = 0.0;
  double arrival_ns = 0.0;
};

double slope(const Point& from, const Point& to) {
  return (to.arrival_ns - from.arrival_ns) / (to.number - from.number);
}

/// The corners of the lower convex hull (Andrew 1979), from left to right.
std::vector<Point> lower_hull(const std::vector<Point>& points) {
  std::vector<Point> hull;
  for (const Point& point : points) {
    while (hull.size() >= 2 && slope(hull[hull.size() - 2], hull.back()) >= slope(hull.back(), point))
      hull.pop_back();
    hull.push_back(point);
  }
  return hull;
}

/// The slope of the hull's edge at the mean number. Of all lines below the points, the one through this hull
/// edge minimises the summed distance.
double period_ns(const std::vector<Point>& points) {
  double mean = 0.0;
  for (const Point& point : points) mean += point.number / static_cast<double>(points.size());
  const std::vector<Point> hull = lower_hull(points);
  std::size_t right = 1;
  while (right + 1 < hull.size() && hull[right].number < mean) ++right;
  return std::round(slope(hull[right - 1], hull[right]));
}

/// A line by Theil and Sen: the median of the slopes between all pairs, and of the distances from it.
struct MedianLine {
  double slope = 0.0;      ///< ns per reading.
  double height_ns = 0.0;  ///< At number 0.
  double u_ns = 0.0;       ///< Standard uncertainty in its middle.

  double at(double number) const { return height_ns + slope * number; }
};

/// Standard deviation of a median over that of a mean, of normal errors: the root of pi/2.
constexpr double kMedianOverMean = 1.2533;
/// Standard deviation of normal errors over their median absolute deviation.
constexpr double kDeviationOverMedian = 1.4826;

MedianLine median_line(const std::vector<Point>& points) {
  std::vector<double> slopes;
  for (std::size_t i = 0; i < points.size(); ++i)
    for (std::size_t k = 0; k < i; ++k) slopes.push_back(slope(points[k], points[i]));
  MedianLine line;
  line.slope = median(std::move(slopes));
  std::vector<double> off;
  for (const Point& point : points) off.push_back(point.arrival_ns - line.slope * point.number);
  line.height_ns = median(off);
  for (double& each : off) each = std::abs(each - line.height_ns);
  line.u_ns = kMedianOverMean * kDeviationOverMedian * median(std::move(off)) /
              std::sqrt(static_cast<double>(points.size()));
  return line;
}

/// The reading with the least delay of each part of `length` readings. A shorter remainder, with larger
/// delays, belongs to the part before it.
std::vector<Point> least_delays(const std::vector<Point>& points, double period, std::size_t length) {
  const auto delay = [&](const Point& point) { return point.arrival_ns - period * point.number; };
  std::vector<Point> least;
  const std::size_t parts = std::max<std::size_t>(1, points.size() / length);
  for (std::size_t part = 0; part < parts; ++part) {
    const auto begin = points.begin() + static_cast<std::ptrdiff_t>(part * length);
    const auto end = part + 1 == parts ? points.end() : begin + static_cast<std::ptrdiff_t>(length);
    least.push_back(*std::ranges::min_element(begin, end, {}, delay));
  }
  return least;
}

}  // namespace

std::optional<SamplingTimes> fit_sampling_times(std::span<const Reading> readings) {
  if (readings.size() < kLeastReadings) return std::nullopt;
  const Reading& first = readings.front();
  std::vector<Point> points;
  points.reserve(readings.size());
  for (const Reading& reading : readings) {
    points.push_back({static_cast<double>(reading.sequence - first.sequence),
                      static_cast<double>((reading.arrival - first.arrival).count())});
    if (points.size() > 1 && points.back().number <= points[points.size() - 2].number) return std::nullopt;
  }
  const double period = period_ns(points);
  if (!(period > 0.0)) return std::nullopt;

  std::array<double, kParts> least{};
  least.fill(std::numeric_limits<double>::infinity());
  for (std::size_t i = 0; i < points.size(); ++i) {
    double& of_part = least[i * kParts / points.size()];
    of_part = std::min(of_part, points[i].arrival_ns - period * points[i].number);
  }
  const double line_ns = *std::ranges::min_element(least);
  const double near_ns = std::max(kNearNs, period / 2.0);
  if (std::ranges::count_if(least, [&](double part) { return part - line_ns > near_ns; }) > kPartsWithout)
    return std::nullopt;
  return SamplingTimes{first.sequence, first.arrival + Clock::Duration(std::llround(line_ns)),
                       Clock::Duration(std::llround(period))};
}

void place_at_sampling_times(std::span<Reading> readings, const AccelerometerInfo& info) {
  if (!(info.rate_hz > 0.0)) return;  // They were made on demand.
  if (const auto times = fit_sampling_times(readings))
    for (Reading& reading : readings) reading.arrival = times->of(reading.sequence);
}

void SamplingClock::hear(std::span<const Reading> readings) {
  for (const Reading& reading : readings) heard_.push_back({reading.sequence, reading.arrival});
}

void SamplingClock::hear_only(std::span<const Reading> readings) {
  heard_.clear();
  hear(readings);
}

/// Leaves the arrivals of the last two minutes that follow each other without a gap, or those of the sweep.
void SamplingClock::keep_last_without_gap(std::span<const Reading> readings) {
  std::size_t begin = heard_.size();
  while (begin > 0 && heard_.back().at - heard_[begin - 1].at < kClockSpan &&
         (begin == heard_.size() || heard_[begin].sequence == heard_[begin - 1].sequence + 1))
    --begin;
  heard_.erase(heard_.begin(), heard_.begin() + static_cast<std::ptrdiff_t>(begin));
  if (heard_.empty() || heard_.front().sequence > readings.front().sequence) hear_only(readings);
}

std::optional<SamplingClock::Placed> SamplingClock::times_of(std::span<const Reading> readings) {
  const auto own = fit_sampling_times(readings);
  if (!own) {
    heard_.clear();
    return std::nullopt;
  }
  keep_last_without_gap(readings);
  const auto period = static_cast<double>(own->period.count());
  while (true) {
    const Arrival begin = heard_.front();
    const auto point_of = [&](std::uint64_t sequence, Clock::Instant at) {
      return Point{static_cast<double>(sequence - begin.sequence),
                   static_cast<double>((at - begin.at).count())};
    };
    std::vector<Point> points;
    points.reserve(heard_.size());
    for (const Arrival& arrival : heard_) points.push_back(point_of(arrival.sequence, arrival.at));
    const auto second = static_cast<std::size_t>(kPartNs / period);
    const std::vector<Point> least = least_delays(
        points, period, std::clamp<std::size_t>(second, 1, std::max<std::size_t>(1, points.size() / kParts)));
    const MedianLine line = median_line(least);
    const Point first = point_of(readings.front().sequence, readings.front().arrival);
    const Point last = point_of(readings.back().sequence, readings.back().arrival);
    std::vector<double> off;
    for (const Point& point : least)
      if (point.number >= first.number) off.push_back(point.arrival_ns - line.at(point.number));
    if (heard_.size() > readings.size() && !off.empty() &&
        !(std::abs(median(std::move(off))) < kMostChangeNs)) {
      hear_only(readings);
      continue;
    }
    // The period is a whole number of nanoseconds: its rounding acts from the middle of the sweep.
    const auto count = static_cast<std::int64_t>(readings.back().sequence - readings.front().sequence);
    const Clock::Duration whole(std::llround(line.slope));
    const double middle = 0.5 * (first.number + last.number);
    const Clock::Instant at_middle = begin.at + Clock::Duration(std::llround(line.at(middle)));
    const double from_middle = (middle - 0.5 * points.back().number) / points.back().number;
    return Placed{{readings.front().sequence, at_middle - count * whole / 2, whole},
                  1e-9 * line.u_ns * std::sqrt(1.0 + 12.0 * from_middle * from_middle)};
  }
}

}  // namespace abcal
