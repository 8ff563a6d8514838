#include "protocol/uncertainty/analysis_of_variance.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

double sum_of(std::span<const double> values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum;
}

double sum_squares_about(std::span<const double> values, double centre) {
  double sum = 0.0;
  for (const double value : values) sum += (value - centre) * (value - centre);
  return sum;
}

void require_finite(std::span<const double> values) {
  for (const double value : values) {
    if (!std::isfinite(value))
      throw std::invalid_argument(
          fmt::format("analysis of variance: a value is {}; finite numbers are required", value));
  }
}

double probability_of_ratio(double f, int between_dof, int within_dof) {
  if (std::isnan(f)) return 1.0;  // nothing scatters at all: nothing speaks against equal groups
  if (std::isinf(f)) return 0.0;
  return f_tail(f * between_dof, between_dof, within_dof);
}

}  // namespace

OneWayAnova one_way_anova(std::span<const std::vector<double>> groups) {
  if (groups.size() < 2) {
    throw std::invalid_argument(
        fmt::format("analysis of variance: {} group(s); at least 2 are required", groups.size()));
  }
  OneWayAnova result;
  result.groups = static_cast<int>(groups.size());
  double sum = 0.0;
  double sum_squared_sizes = 0.0;
  for (const std::vector<double>& group : groups) {
    if (group.empty()) throw std::invalid_argument("analysis of variance: a group is empty");
    require_finite(group);
    const auto size = static_cast<double>(group.size());
    sum += sum_of(group);
    sum_squared_sizes += size * size;
    result.observations += static_cast<int>(group.size());
  }
  if (result.observations == result.groups) {
    throw std::invalid_argument(
        "analysis of variance: no group has two observations; without them nothing is known of the scatter "
        "within a group");
  }
  const auto observations = static_cast<double>(result.observations);
  result.mean = sum / observations;
  for (const std::vector<double>& group : groups) {
    const auto size = static_cast<double>(group.size());
    const double group_mean = sum_of(group) / size;
    result.between_sum_squares += size * (group_mean - result.mean) * (group_mean - result.mean);
    result.within_sum_squares += sum_squares_about(group, group_mean);
  }
  result.between_degrees_of_freedom = result.groups - 1;
  result.within_degrees_of_freedom = result.observations - result.groups;

  const double within = result.within_mean_square();
  result.f = result.between_mean_square() / within;
  result.f_probability =
      probability_of_ratio(result.f, result.between_degrees_of_freedom, result.within_degrees_of_freedom);
  result.repeatability = std::sqrt(within);
  // ISO 5725-2, 7.4.5: the size that an equal group would have.
  const double mean_size =
      (observations - sum_squared_sizes / observations) / result.between_degrees_of_freedom;
  const double between = std::max(0.0, (result.between_mean_square() - within) / mean_size);
  result.between = std::sqrt(between);
  result.reproducibility = std::sqrt(within + between);
  // Where the groups do not differ, all observations are of one kind (GUM H.5.2.5).
  const double one_kind = (result.between_sum_squares + result.within_sum_squares) / (observations - 1.0);
  const double mean_variance =
      between > 0.0 ? between * sum_squared_sizes / (observations * observations) + within / observations
                    : one_kind / observations;
  result.mean_standard_uncertainty = std::sqrt(mean_variance);
  return result;
}

RunSpread spread_between_runs(std::span<const double> values, std::span<const double> type_a) {
  if (values.size() < 2 || values.size() != type_a.size()) {
    throw std::invalid_argument(
        fmt::format("spread between runs: {} values, {} type A uncertainties; required: one of each for at "
                    "least two runs",
                    values.size(), type_a.size()));
  }
  require_finite(values);
  double weights = 0.0;
  double weighted_sum = 0.0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!(type_a[i] > 0.0 && std::isfinite(type_a[i]))) {
      throw std::invalid_argument(
          fmt::format("spread between runs: a type A uncertainty is {}; required: above 0", type_a[i]));
    }
    const double weight = 1.0 / (type_a[i] * type_a[i]);
    weights += weight;
    weighted_sum += weight * values[i];
  }
  RunSpread spread;
  spread.runs = static_cast<int>(values.size());
  const auto runs = static_cast<double>(values.size());
  spread.mean = sum_of(values) / runs;
  const double variance = sum_squares_about(values, spread.mean) / (runs - 1.0);
  const double within = sum_squares_about(type_a, 0.0) / runs;
  const double between = std::max(0.0, variance - within);
  spread.standard_deviation = std::sqrt(variance);
  spread.within = std::sqrt(within);
  spread.between = std::sqrt(between);
  const double weighted_mean = weighted_sum / weights;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const double deviate = (values[i] - weighted_mean) / type_a[i];
    spread.chi2 += deviate * deviate;
  }
  spread.chi2_probability = chi2_tail(spread.chi2, static_cast<int>(values.size()) - 1);
  spread.mean_standard_uncertainty = std::sqrt((between + within) / runs);
  return spread;
}

}  // namespace abcal
