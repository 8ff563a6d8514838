#include "protocol/uncertainty/coverage.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace abcal {

namespace {

constexpr double kHalfWidth = 8.0;  // u; by Chebyshev 95 % of any distribution lies within 4.5 u of its mean
constexpr double kBinsPerU = 1000.0;

void check_probability(double p) {
  if (!(p > 0.0 && p < 1.0)) {
    throw std::invalid_argument("coverage probability = " + std::to_string(p) +
                                ", it must lie between 0 and 1");
  }
}

// Number of values between the end points of an interval, and the rank (from 1) of the symmetric one's lower
// end (JCGM 101:2008, 7.7.2).
struct Ranks {
  std::uint64_t q = 0, r = 0;
};

Ranks ranks(std::uint64_t m, double p) {
  const double pm = p * static_cast<double>(m);
  const auto q = static_cast<std::uint64_t>(std::floor(pm + 0.5));  // pM itself where that is a whole number
  if (q < 1 || q >= m) {
    throw std::invalid_argument(std::to_string(m) +
                                " values are too few for a coverage interval of probability " +
                                std::to_string(p));
  }
  return {q, (m - q + 1) / 2};
}

}  // namespace

Coverage coverage_of_sorted(std::span<const double> sorted, double p) {
  check_probability(p);
  const auto [q, r] = ranks(sorted.size(), p);
  Coverage coverage;
  coverage.symmetric = {sorted[r - 1], sorted[r - 1 + q]};
  std::size_t best = 0;
  for (std::size_t i = 1; i + q < sorted.size(); ++i) {
    if (sorted[i + q] - sorted[i] < sorted[best + q] - sorted[best]) best = i;
  }
  coverage.shortest = {sorted[best], sorted[best + q]};
  return coverage;
}

Coverage coverage_of(std::span<double> values, double p) {
  check_probability(p);
  const std::uint64_t q = ranks(values.size(), p).q;
  // Both intervals begin among the M - q smallest values and end among as many of the largest.
  const auto tail = static_cast<std::ptrdiff_t>(values.size() - q);
  const auto upper = static_cast<std::ptrdiff_t>(q);
  if (tail < upper) {
    std::nth_element(values.begin(), values.begin() + tail, values.end());
    std::nth_element(values.begin() + tail, values.begin() + upper, values.end());
    std::sort(values.begin(), values.begin() + tail);
    std::sort(values.begin() + upper, values.end());
  } else {
    std::sort(values.begin(), values.end());
  }
  return coverage_of_sorted(values, p);
}

GridHistogram::GridHistogram(double centre, double u)
    : low_(centre - kHalfWidth * u),
      width_(u / kBinsPerU),
      smallest_(std::numeric_limits<double>::infinity()),
      largest_(-std::numeric_limits<double>::infinity()),
      bins_(u > 0.0 ? static_cast<std::size_t>(2.0 * kHalfWidth * kBinsPerU) : 0, 0) {}

void GridHistogram::add(double value) {
  ++total_;
  smallest_ = std::min(smallest_, value);
  largest_ = std::max(largest_, value);
  if (bins_.empty()) return;
  const double position = (value - low_) / width_;
  if (position < 0.0) {
    ++below_;
  } else if (position >= static_cast<double>(bins_.size())) {
    ++above_;
  } else {
    ++bins_[static_cast<std::size_t>(position)];
  }
}

void GridHistogram::add(const GridHistogram& other) {
  if (other.low_ != low_ || other.width_ != width_ || other.bins_.size() != bins_.size()) {
    throw std::invalid_argument("histograms on different grids cannot be added");
  }
  total_ += other.total_;
  below_ += other.below_;
  above_ += other.above_;
  smallest_ = std::min(smallest_, other.smallest_);
  largest_ = std::max(largest_, other.largest_);
  for (std::size_t i = 0; i < bins_.size(); ++i) bins_[i] += other.bins_[i];
}

Coverage GridHistogram::coverage(double p) const {
  check_probability(p);
  const auto [q, r] = ranks(total_, p);
  if (bins_.empty()) return {{smallest_, largest_}, {smallest_, largest_}};
  // A value of rank k (from 1) lies in the bin where the running count reaches k; the ranks of a bin are
  // spread evenly over its width. Ranks outside the grid are the extreme values.
  struct Edge {
    std::uint64_t before;  // ranks below this bin
    std::uint32_t count;
    double low;
  };
  std::vector<Edge> edges;
  std::uint64_t before = below_;
  for (std::size_t i = 0; i < bins_.size(); ++i) {
    if (bins_[i] > 0) edges.push_back({before, bins_[i], low_ + width_ * static_cast<double>(i)});
    before += bins_[i];
  }
  const auto value_of = [&](std::uint64_t rank, std::size_t& hint) {
    if (rank <= below_) return smallest_;
    if (rank > total_ - above_) return largest_;
    while (hint + 1 < edges.size() && edges[hint + 1].before < rank) ++hint;
    const Edge& edge = edges[hint];
    return edge.low +
           width_ * (static_cast<double>(rank - edge.before) - 0.5) / static_cast<double>(edge.count);
  };
  Coverage coverage;
  std::size_t hint = 0;
  coverage.symmetric.low = value_of(r, hint);
  coverage.symmetric.high = value_of(r + q, hint);
  // The shortest interval begins, to a bin, at the first rank of a bin.
  coverage.shortest = coverage.symmetric;
  std::size_t low_hint = 0, high_hint = 0;
  for (const Edge& edge : edges) {
    const std::uint64_t rank = edge.before + 1;
    if (rank + q > total_) break;
    const CoverageInterval interval = {value_of(rank, low_hint), value_of(rank + q, high_hint)};
    if (interval.high - interval.low < coverage.shortest.high - coverage.shortest.low)
      coverage.shortest = interval;
  }
  return coverage;
}

}  // namespace abcal
