#include "app/results/export/reading_noise.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "protocol/record/run_file.h"

namespace abcal {
namespace {

constexpr double kWantedTauS = 1.0;
/// This number of averages in a dwell gives four differences.
constexpr std::size_t kLeastAverages = 5;

/// Sums of squared differences of neighbouring averages of `length` readings.
struct AllanSum {
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  std::size_t count = 0;

  void add(const std::vector<StoredReading>& readings, std::size_t length) {
    std::optional<Eigen::Vector3d> before;
    for (std::size_t first = 0; first + length <= readings.size(); first += length) {
      Eigen::Vector3d mean = Eigen::Vector3d::Zero();
      for (std::size_t i = first; i < first + length; ++i) mean += readings[i].output;
      mean /= static_cast<double>(length);
      if (!mean.allFinite()) return;
      if (before) {
        squares += (mean - *before).cwiseAbs2();
        ++count;
      }
      before = mean;
    }
  }
};

}  // namespace

std::optional<ReadingNoise> noise_of_readings(const std::filesystem::path& run, int item) {
  // The shortest dwell decides how many readings are averaged, its times how long that lasts.
  std::size_t shortest = std::numeric_limits<std::size_t>::max();
  double span_s = 0.0;
  std::size_t gaps = 0;
  RunFile::read_dwells(
      run,
      [&](const StoredDwell& dwell) {
        shortest = std::min(shortest, dwell.readings.size());
        if (dwell.readings.size() < 2) return;
        span_s += dwell.readings.back().time_s - dwell.readings.front().time_s;
        gaps += dwell.readings.size() - 1;
      },
      item);
  if (gaps == 0 || !(span_s > 0.0) || shortest < kLeastAverages) return std::nullopt;
  const double period_s = span_s / static_cast<double>(gaps);
  const std::size_t length = std::clamp<std::size_t>(
      static_cast<std::size_t>(std::lround(kWantedTauS / period_s)), 1, shortest / kLeastAverages);
  AllanSum sum;
  RunFile::read_dwells(
      run, [&](const StoredDwell& dwell) { sum.add(dwell.readings, length); }, item);
  if (sum.count == 0) return std::nullopt;
  const double tau_s = static_cast<double>(length) * period_s;
  const double variance = sum.squares.maxCoeff() / (2.0 * static_cast<double>(sum.count));
  return ReadingNoise{std::sqrt(variance * tau_s), 1.0 / period_s, tau_s};
}

}  // namespace abcal
