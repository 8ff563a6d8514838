#include "protocol/uncertainty/coverage.h"

#include <algorithm>
#include <boost/sort/pdqsort/pdqsort.hpp>
#include <cmath>
#include <limits>
#include <optional>
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

/// Both intervals begin among the M - q smallest values and end among as many of the largest.
/// @param low, high  these, sorted
Coverage coverage_of_tails(std::span<const double> low, std::span<const double> high, std::uint64_t r) {
  Coverage coverage;
  coverage.symmetric = {low[r - 1], high[r - 1]};
  std::size_t best = 0;
  for (std::size_t i = 1; i < low.size(); ++i) {
    if (high[i] - low[i] < high[best] - low[best]) best = i;
  }
  coverage.shortest = {low[best], high[best]};
  return coverage;
}

/// All values below one limit and above another.
struct Tails {
  std::vector<double> low, high;
};

/// At least the `tail` smallest and largest values, and few more, in one pass: the limits come from every
/// n-th value. Nullopt if the tails are long or the sample is not representative.
std::optional<Tails> tails_of(std::span<const double> values, std::size_t tail) {
  constexpr std::size_t kSample = 4000;
  constexpr double kMargin = 4.0;  // standard deviations of a sample's rank
  if (values.size() < 4 * kSample || tail > values.size() / 4) return std::nullopt;
  std::vector<double> sample;
  const std::size_t step = values.size() / kSample;
  for (std::size_t i = 0; i < values.size(); i += step) sample.push_back(values[i]);
  boost::sort::pdqsort(sample.begin(), sample.end());
  const auto count = static_cast<double>(sample.size());
  const double share = static_cast<double>(tail) / static_cast<double>(values.size());
  const auto rank =
      static_cast<std::size_t>(count * share + kMargin * std::sqrt(count * share * (1.0 - share)) + 1.0);
  const double low_limit = sample[rank];
  const double high_limit = sample[sample.size() - 1 - rank];
  Tails tails;
  const std::size_t expected = values.size() / sample.size() * (rank + rank / 8);
  tails.low.reserve(expected);
  tails.high.reserve(expected);
  for (const double value : values) {
    if (value <= low_limit) tails.low.push_back(value);
    if (value >= high_limit) tails.high.push_back(value);
  }
  if (tails.low.size() < tail || tails.high.size() < tail) return std::nullopt;
  return tails;
}

}  // namespace

Coverage coverage_of_sorted(std::span<const double> sorted, double p) {
  check_probability(p);
  const auto [q, r] = ranks(sorted.size(), p);
  const std::size_t tail = sorted.size() - q;
  return coverage_of_tails(sorted.first(tail), sorted.last(tail), r);
}

Coverage coverage_of(std::span<double> values, double p) {
  check_probability(p);
  const auto [q, r] = ranks(values.size(), p);
  const std::size_t tail = values.size() - q;
  if (std::optional<Tails> tails = tails_of(values, tail)) {
    boost::sort::pdqsort(tails->low.begin(), tails->low.end());
    boost::sort::pdqsort(tails->high.begin(), tails->high.end());
    return coverage_of_tails(std::span(tails->low).first(tail), std::span(tails->high).last(tail), r);
  }
  boost::sort::pdqsort(values.begin(), values.end());
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
