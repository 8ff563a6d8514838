#include "protocol/uncertainty/control_chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>

#include "protocol/uncertainty/analysis_of_variance.h"

namespace abcal {
namespace {

constexpr double kLimitWidth = 3.0;  // standard deviations
// Mean range of two normal values in standard deviations, 2/sqrt(pi), with the digits of ISO 7870-2, so that
// limits equal those of other programs.
constexpr double kMeanRangeOfTwo = 1.128;

void require_finite(std::span<const double> values, std::size_t at_least) {
  if (values.size() < at_least) {
    throw std::invalid_argument(
        fmt::format("control chart: {} value(s); at least {} are required", values.size(), at_least));
  }
  for (const double value : values) {
    if (!std::isfinite(value))
      throw std::invalid_argument(
          fmt::format("control chart: a value is {}; finite numbers are required", value));
  }
}

ChartPoint point_between(double value, double centre, double half_width) {
  return {value, centre - half_width, centre + half_width};
}

}  // namespace

bool ControlChart::has_spread() const {
  // A mean of n equal values is off by up to n half units of its last digit.
  const double rounding = static_cast<double>(points.size() + 1) * std::numeric_limits<double>::epsilon();
  return standard_deviation > rounding * std::abs(centre);
}

bool ControlChart::inside(std::size_t point) const {
  return !has_spread() || points.at(point).inside();
}

bool ControlChart::in_control() const {
  for (std::size_t k = 0; k < points.size(); ++k)
    if (!inside(k)) return false;
  return true;
}

ControlChart individuals_chart(std::span<const double> values) {
  require_finite(values, 2);
  ControlChart chart;
  double ranges = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    chart.centre += values[i] / static_cast<double>(values.size());
    if (i > 0) ranges += std::abs(values[i] - values[i - 1]);
  }
  chart.standard_deviation = ranges / static_cast<double>(values.size() - 1) / kMeanRangeOfTwo;
  for (const double value : values)
    chart.points.push_back(point_between(value, chart.centre, kLimitWidth * chart.standard_deviation));
  return chart;
}

ControlChart mean_chart(std::span<const std::vector<double>> groups) {
  const OneWayAnova anova = one_way_anova(groups);
  ControlChart chart;
  chart.centre = anova.mean;
  const double mean_size = static_cast<double>(anova.observations) / anova.groups;
  chart.standard_deviation = anova.repeatability / std::sqrt(mean_size);
  for (const std::vector<double>& group : groups) {
    double mean = 0.0;
    for (const double value : group) mean += value / static_cast<double>(group.size());
    chart.points.push_back(
        point_between(mean, chart.centre,
                      kLimitWidth * anova.repeatability / std::sqrt(static_cast<double>(group.size()))));
  }
  return chart;
}

ControlChart ewma_chart(std::span<const double> values, double centre, double standard_deviation,
                        double weight) {
  require_finite(values, 1);
  if (!(weight > 0.0 && weight <= 1.0))
    throw std::invalid_argument(fmt::format(
        "control chart: the weight of the moving average is {}; required: above 0, at most 1", weight));
  if (!(standard_deviation >= 0.0) || !std::isfinite(centre + standard_deviation))
    throw std::invalid_argument("control chart: centre and standard deviation are not finite");
  ControlChart chart;
  chart.centre = centre;
  const double lasting = standard_deviation * std::sqrt(weight / (2.0 - weight));
  chart.standard_deviation = lasting;
  double average = centre;
  double forgotten = 1.0;  // (1 - weight)^(2i)
  for (const double value : values) {
    average = weight * value + (1.0 - weight) * average;
    forgotten *= (1.0 - weight) * (1.0 - weight);
    chart.points.push_back(
        point_between(average, centre, kLimitWidth * lasting * std::sqrt(1.0 - forgotten)));
  }
  return chart;
}

}  // namespace abcal
