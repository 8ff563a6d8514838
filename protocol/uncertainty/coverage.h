#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace abcal {

/// A coverage interval.
struct CoverageInterval {
  double low = 0.0;
  double high = 0.0;
};

/// Both intervals of JCGM 101 for one output.
struct Coverage {
  CoverageInterval symmetric;  ///< Probabilistically symmetric: (1 - p)/2 below and above.
  CoverageInterval shortest;   ///< The shortest that holds the fraction p.
};

/// Probabilistically symmetric and shortest coverage intervals of sorted values (JCGM 101:2008, 7.7):
/// q = p M rounded, symmetric from y_(r) to y_(r+q) with r = (M - q)/2 rounded up, shortest by search over r.
/// @throws std::invalid_argument for p outside (0, 1), or fewer values than the interval needs (q < 1 or q >=
/// M).
Coverage coverage_of_sorted(std::span<const double> sorted, double p);

/// Like coverage_of_sorted(), from values in any order, which it may reorder: only the tails are sorted.
Coverage coverage_of(std::span<double> values, double p);

/// Counts on a fixed grid, for more trials than are kept. Adding is exact and does not depend on the order,
/// so histograms filled by different threads and then added are one histogram.
class GridHistogram {
 public:
  /// Bins of width u * 1e-3 over centre -+ 8 u; values outside are counted at the ends. A u of zero (an
  /// output that does not vary) keeps the smallest and the largest value only.
  GridHistogram(double centre, double u);

  void add(double value);
  void add(const GridHistogram& other);  ///< Same grid. @throws std::invalid_argument otherwise.
  std::uint64_t count() const { return total_; }
  double bin_width() const { return width_; }
  Coverage coverage(double p) const;  ///< End points good to one bin.

 private:
  double low_ = 0.0, width_ = 0.0;
  double smallest_, largest_;
  std::uint64_t total_ = 0, below_ = 0, above_ = 0;
  std::vector<std::uint32_t> bins_;
};

}  // namespace abcal
