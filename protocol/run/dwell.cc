#include "protocol/run/dwell.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "protocol/record/run_record.h"

namespace abcal {
namespace {

std::vector<Eigen::Vector3d> outputs_of(std::span<const Reading> readings) {
  std::vector<Eigen::Vector3d> outputs;
  outputs.reserve(readings.size());
  for (const Reading& reading : readings) outputs.push_back(reading.output);
  return outputs;
}

}  // namespace

Eigen::Vector3d spread_of(std::span<const Reading> readings) {
  return mean_and_spread(outputs_of(readings)).spread;
}

DwellStatistics dwell_statistics(std::span<const Reading> readings, const AccelerometerInfo& info) {
  DwellStatistics result;
  std::vector<Eigen::Vector3d> finite;
  finite.reserve(readings.size());
  double temperature = 0.0;
  std::int64_t temperatures = 0;
  for (std::size_t k = 0; k < readings.size(); ++k) {
    const Reading& reading = readings[k];
    if (k > 0 && reading.sequence > readings[k - 1].sequence + 1) {
      result.lost += static_cast<std::int64_t>(reading.sequence - readings[k - 1].sequence - 1);
    }
    const bool clipped =
        reading.over_range || (info.full_scale && reading.output.cwiseAbs().maxCoeff() >= *info.full_scale);
    if (clipped) result.flags |= kFlagClipped;
    if (reading.temperature_degc && std::isfinite(*reading.temperature_degc)) {
      temperature += *reading.temperature_degc;
      ++temperatures;
    }
    if (reading.output.allFinite()) {
      finite.push_back(reading.output);
    } else {
      ++result.not_finite;
    }
  }
  if (result.not_finite > 0) result.flags |= kFlagNotFinite;
  if (result.lost > 0) result.flags |= kFlagLostReadings;
  if (temperatures > 0) result.temperature_degc = temperature / static_cast<double>(temperatures);
  result.count = static_cast<std::int64_t>(finite.size());
  if (finite.empty()) return result;

  const ReadingStatistics statistics = reading_statistics(finite, info.resolution.value_or(0.0));
  result.mean = statistics.mean;
  result.spread = statistics.spread;
  result.u_mean = statistics.u_mean;
  return result;
}

bool is_quiet(std::span<const Reading> window, const std::optional<Eigen::Vector3d>& usual_spread,
              double spread_factor, double resolution, double drift) {
  const std::size_t n = window.size();
  if (n < 4) return true;
  const auto count = static_cast<double>(n);
  const double middle = (count - 1.0) / 2.0;
  const double sum_kk = count * (count * count - 1.0) / 12.0;  // sum of (k - middle)^2
  // Student's t that a window without slope exceeds once in 1e5 windows, to a few percent for 8 and more
  // degrees of freedom.
  const double t_limit = 4.5 + 30.0 / (count - 2.0);
  const ReadingStatistics statistics = mean_and_spread(outputs_of(window));
  const Eigen::Vector3d& mean = statistics.mean;
  const Eigen::Vector3d& spread = statistics.spread;
  for (int j = 0; j < 3; ++j) {
    double slope = 0.0;  // of the least-squares line, R a reading
    for (std::size_t k = 0; k < n; ++k) {
      slope += (static_cast<double>(k) - middle) * (window[k].output[j] - mean[j]) / sum_kk;
    }
    const double squares = spread[j] * spread[j] * (count - 1.0);
    const double residual = std::sqrt(std::max(0.0, squares - slope * slope * sum_kk) / (count - 2.0));
    const double slope_limit =
        std::max(t_limit * std::hypot(residual / std::sqrt(sum_kk), drift * mean.norm()), resolution / count);
    // A reading that is not finite makes the comparison false, and the window not quiet.
    if (!(std::abs(slope) <= slope_limit)) return false;
    if (!usual_spread || std::isnan((*usual_spread)[j])) continue;
    if (!(spread[j] <= std::max(spread_factor * (*usual_spread)[j], resolution))) return false;
  }
  return true;
}

}  // namespace abcal
