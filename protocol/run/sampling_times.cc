#include "protocol/run/sampling_times.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace abcal {
namespace {

constexpr std::size_t kLeastReadings = 16;
/// Parts of a dwell, and those of them in which no reading need come near the line.
constexpr std::size_t kParts = 8;
constexpr std::ptrdiff_t kPartsWithout = 2;
constexpr double kNearNs = 0.5e6;

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

/// The slope of the hull's edge at the mean number: of all lines below the points the one along this edge has
/// the least sum of distances.
double period_ns(const std::vector<Point>& points) {
  double mean = 0.0;
  for (const Point& point : points) mean += point.number / static_cast<double>(points.size());
  const std::vector<Point> hull = lower_hull(points);
  std::size_t right = 1;
  while (right + 1 < hull.size() && hull[right].number < mean) ++right;
  return std::round(slope(hull[right - 1], hull[right]));
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

}  // namespace abcal
