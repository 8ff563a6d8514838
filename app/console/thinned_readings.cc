#include "app/console/thinned_readings.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace abcal::console {

ThinnedReadings::ThinnedReadings(std::size_t dwells, std::size_t columns)
    : parts_(std::max<std::size_t>(1, columns / std::max<std::size_t>(1, dwells))),
      joined_(std::max<std::size_t>(1, (dwells + columns - 1) / std::max<std::size_t>(1, columns))) {}

void ThinnedReadings::add(std::span<const StoredReading> readings) {
  const bool with_last = dwells_ % joined_ != 0;
  ++dwells_;
  count_ += readings.size();
  if (readings.empty()) return;
  // Up to twice as many single readings as parts are drawn as they are.
  const std::size_t parts = readings.size() <= 2 * parts_ && joined_ == 1 ? readings.size() : parts_;
  for (std::size_t k = 0; k < parts; ++k) {
    const std::size_t from = readings.size() * k / parts, to = readings.size() * (k + 1) / parts;
    add_part(readings.subspan(from, to - from), with_last && !points_.empty());
  }
}

void ThinnedReadings::add_part(std::span<const StoredReading> readings, bool with_last) {
  if (!with_last) {
    const Eigen::Vector3d none = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
    points_.push_back({0.0, none, none});
    first_s_ = readings.front().time_s;
  }
  Point& point = points_.back();
  point.time_s = 0.5 * (first_s_ + readings.back().time_s);
  for (const StoredReading& reading : readings) {
    for (Eigen::Index j = 0; j < 3; ++j) {
      // fmin and fmax leave out what is not a number.
      point.lowest[j] = std::fmin(point.lowest[j], reading.output[j]);
      point.highest[j] = std::fmax(point.highest[j], reading.output[j]);
    }
  }
}

}  // namespace abcal::console
