#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace abcal {

/// One point of a control chart with its limits.
struct ChartPoint {
  double value = 0.0;
  double lower = 0.0;
  double upper = 0.0;
  bool inside() const { return value >= lower && value <= upper; }
};

/// A control chart (ISO/IEC 17025, 7.7; ISO 7870-2): the behaviour of a stable process. Limits are three
/// standard deviations from the centre line.
struct ControlChart {
  double centre = 0.0;
  double standard_deviation = 0.0;  ///< Standard deviation of one plotted point if the process is stable.
  std::vector<ChartPoint> points;   ///< In the order given; for the EWMA the averages.
  /// False: values differ by nothing but rounding. The limits then have no width and judge nothing.
  bool has_spread() const;
  /// Whether a point is inside of its limits; where there is no spread, every point is.
  bool inside(std::size_t point) const;
  bool in_control() const;
};

/// Single values: the standard deviation is the mean moving range over 1.128 (d2 of two values), so that a
/// slow drift does not widen the limits.
/// @throws std::invalid_argument fewer than two values, or one that is not finite
ControlChart individuals_chart(std::span<const double> values);

/// Means of groups about their common mean, with limits from the pooled scatter within groups: points outside
/// mean that groups differ by more than repeatability.
/// @throws std::invalid_argument as one_way_anova()
ControlChart mean_chart(std::span<const std::vector<double>> groups);

/// Exponentially weighted moving average z_i = weight x_i + (1 - weight) z_(i-1) from z_0 = centre: detects a
/// small lasting shift that single values do not. Limits grow with i to their lasting width.
/// @param standard_deviation  of a single value, > 0 or 0
/// @throws std::invalid_argument weight outside (0, 1], no values, or a value that is not finite
ControlChart ewma_chart(std::span<const double> values, double centre, double standard_deviation,
                        double weight);

}  // namespace abcal
