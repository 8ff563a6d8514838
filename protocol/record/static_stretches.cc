#include "protocol/record/static_stretches.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace abcal {
namespace {

/// Cumulative sums over samples: mean and spread of a window take the same time for any length.
class RunningSums {
 public:
  explicit RunningSums(const std::vector<Eigen::Vector3d>& readings)
      : shift_(readings.front()), sum_(readings.size() + 1), square_(readings.size() + 1) {
    sum_[0].setZero();
    square_[0].setZero();
    for (std::size_t i = 0; i < readings.size(); ++i) {
      const Eigen::Vector3d r = readings[i] - shift_;
      sum_[i + 1] = sum_[i] + r;
      square_[i + 1] = square_[i] + r.cwiseAbs2();
    }
  }
  Eigen::Vector3d mean(std::size_t first, std::size_t last) const {
    return shift_ + (sum_[last] - sum_[first]) / static_cast<double>(last - first);
  }
  Eigen::Vector3d spread(std::size_t first, std::size_t last) const {
    const auto n = static_cast<double>(last - first);
    const Eigen::Vector3d sum = sum_[last] - sum_[first];
    const Eigen::Vector3d squares = square_[last] - square_[first] - sum.cwiseAbs2() / n;
    return (squares / (n - 1.0)).cwiseMax(0.0).cwiseSqrt();
  }

 private:
  Eigen::Vector3d shift_;
  std::vector<Eigen::Vector3d> sum_, square_;
};

/// Standard uncertainty of the mean from the scatter of batch means: neighbouring readings of a filtered
/// output are not independent, batches that are long against the filter are.
Eigen::Vector3d batch_uncertainty(const RunningSums& sums, std::size_t first, std::size_t last) {
  constexpr std::size_t kBatches = 8;
  const std::size_t length = (last - first) / kBatches;
  if (length < 2) return sums.spread(first, last) / std::sqrt(static_cast<double>(last - first));
  const Eigen::Vector3d mean = sums.mean(first, first + kBatches * length);
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < kBatches; ++i) {
    squares += (sums.mean(first + i * length, first + (i + 1) * length) - mean).cwiseAbs2();
  }
  return (squares / static_cast<double>(kBatches * (kBatches - 1))).cwiseSqrt();
}

void check(const TimeSeries& series, const StaticSearch& search) {
  if (series.time_s.size() != series.reading.size()) {
    throw std::invalid_argument(
        fmt::format("time series: {} times and {} readings", series.time_s.size(), series.reading.size()));
  }
  for (std::size_t i = 0; i < series.time_s.size(); ++i) {
    if (!std::isfinite(series.time_s[i]) || !series.reading[i].allFinite()) {
      throw std::invalid_argument(fmt::format("time series: row {} is not finite", i + 1));
    }
    if (i > 0 && !(series.time_s[i] > series.time_s[i - 1])) {
      throw std::invalid_argument(fmt::format("time series: row {}: time {} s does not come after {} s",
                                              i + 1, series.time_s[i], series.time_s[i - 1]));
    }
  }
  const auto positive = [](double x) { return std::isfinite(x) && x > 0.0; };
  if (!positive(search.window_s) || !positive(search.threshold) || !positive(search.min_length_s) ||
      !(search.trim_s >= 0.0) || !std::isfinite(search.trim_s)) {
    throw std::invalid_argument(
        "time series: window, threshold and shortest stretch must be greater than zero, the "
        "trim zero or more");
  }
}

/// Spread below which an output is at rest: a multiple of the lowest tenth (quantile) of the running spreads.
Eigen::Vector3d spread_limit(const TimeSeries& series, const std::vector<Eigen::Vector3d>& spread,
                             double threshold) {
  const std::size_t n = spread.size();
  Eigen::Vector3d limit;
  for (Eigen::Index j = 0; j < 3; ++j) {
    std::vector<double> sorted(n);
    for (std::size_t i = 0; i < n; ++i) sorted[i] = spread[i](j);
    const auto tenth = sorted.begin() + static_cast<std::ptrdiff_t>(n / 10);
    std::nth_element(sorted.begin(), tenth, sorted.end());
    // The spread of a quiet output may be below its resolution: one step of it does not count as motion.
    double resolution = std::numeric_limits<double>::infinity();
    for (std::size_t i = 1; i < n; ++i) {
      const double step = std::abs(series.reading[i](j) - series.reading[i - 1](j));
      if (step > 0.0) resolution = std::min(resolution, step);
    }
    if (!std::isfinite(resolution)) resolution = 0.0;
    limit(j) = threshold * std::max(*tenth, resolution / std::sqrt(12.0));
  }
  return limit;
}

/// Collects stretches, and joins the parts of a pose that a knock has interrupted.
class StretchCollector {
 public:
  StretchCollector(const TimeSeries& series, const StaticSearch& search, const RunningSums& sums,
                   const Eigen::Vector3d& limit)
      : series_(series), search_(search), sums_(sums), limit_(limit) {}

  /// Samples first .. last - 1 were quiet in the short window.
  void add(std::size_t first, std::size_t last) {
    const double start = series_.time_s[first] + search_.trim_s;
    const double end = series_.time_s[last - 1] - search_.trim_s;
    // A part of a pose may be shorter than a pose: parts separated by a knock are joined.
    if (end - start < 0.25 * search_.min_length_s) return;
    StaticStretch stretch;
    stretch.first = sample_at(start);
    stretch.last = sample_at(end) + 1;
    if (stretch.last - stretch.first < 8) return;
    stretch.count = stretch.last - stretch.first;
    stretch.spread = sums_.spread(stretch.first, stretch.last);
    // Slow turning passes the short window but not the whole stretch.
    if ((stretch.spread.array() > limit_.array()).any()) return;
    stretch.mean = sums_.mean(stretch.first, stretch.last);
    stretch.u_mean = batch_uncertainty(sums_, stretch.first, stretch.last);
    stretch.start_s = series_.time_s[stretch.first];
    stretch.end_s = series_.time_s[stretch.last - 1];
    if (found_.empty() || !goes_on(found_.back(), stretch)) {
      found_.push_back(stretch);
    } else {
      join(found_.back(), stretch);
    }
  }
  std::vector<StaticStretch> take() { return std::move(found_); }

 private:
  std::size_t sample_at(double time) const {
    return static_cast<std::size_t>(std::lower_bound(series_.time_s.begin(), series_.time_s.end(), time) -
                                    series_.time_s.begin());
  }
  /// Whether a stretch continues the pose before, after a knock. Half the scatter of one reading is far below
  /// any turn by hand; the means of short parts may differ by five of their uncertainties.
  bool goes_on(const StaticStretch& before, const StaticStretch& stretch) const {
    const Eigen::Vector3d u = (stretch.u_mean.cwiseAbs2() + before.u_mean.cwiseAbs2()).cwiseSqrt();
    const Eigen::Vector3d allowed = (0.5 * limit_ / search_.threshold).cwiseMax(5.0 * u);
    return ((stretch.mean - before.mean).array().abs() <= allowed.array()).all();
  }
  static void join(StaticStretch& before, const StaticStretch& stretch) {
    const auto a = static_cast<double>(before.count);
    const auto b = static_cast<double>(stretch.count);
    before.mean = (a * before.mean + b * stretch.mean) / (a + b);
    before.spread = ((a * before.spread.cwiseAbs2() + b * stretch.spread.cwiseAbs2()) / (a + b)).cwiseSqrt();
    before.u_mean =
        (a * a * before.u_mean.cwiseAbs2() + b * b * stretch.u_mean.cwiseAbs2()).cwiseSqrt() / (a + b);
    before.count += stretch.count;
    before.last = stretch.last;
    before.end_s = stretch.end_s;
  }

  const TimeSeries& series_;
  const StaticSearch& search_;
  const RunningSums& sums_;
  Eigen::Vector3d limit_;
  std::vector<StaticStretch> found_;
};

}  // namespace

std::vector<StaticStretch> static_stretches(const TimeSeries& series, const StaticSearch& search) {
  check(series, search);
  const std::size_t n = series.time_s.size();
  if (n < 16) return {};
  const double period = (series.time_s.back() - series.time_s.front()) / static_cast<double>(n - 1);
  const auto half = std::max<std::size_t>(2, static_cast<std::size_t>(0.5 * search.window_s / period));
  if (n < 2 * half + 1) return {};

  const RunningSums sums(series.reading);
  std::vector<Eigen::Vector3d> spread(n);
  for (std::size_t i = 0; i < n; ++i) {
    spread[i] = sums.spread(i < half ? 0 : i - half, std::min(n, i + half + 1));
  }
  const Eigen::Vector3d limit = spread_limit(series, spread, search.threshold);
  StretchCollector collector(series, search, sums, limit);
  std::size_t first = 0;
  bool still = false;
  for (std::size_t i = 0; i <= n; ++i) {
    const bool now = i < n && (spread[i].array() <= limit.array()).all();
    if (now && !still) first = i;
    if (!now && still) collector.add(first, i);
    still = now;
  }
  std::vector<StaticStretch> found = collector.take();
  std::erase_if(found, [&](const StaticStretch& stretch) {
    return static_cast<double>(stretch.count) * period < search.min_length_s;
  });
  return found;
}

}  // namespace abcal
