#include "protocol/uncertainty/run_length.h"

#include <fmt/format.h>

#include <Eigen/Core>
#include <boost/math/quadrature/gauss.hpp>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>

#include "protocol/linear/lu.h"
#include "protocol/uncertainty/normal_probability.h"

namespace abcal {
namespace {

constexpr Eigen::Index kStates = 101;  // States of the chain: reach the published run lengths exactly.
constexpr int kNodes = 60;  // Nodes of the integral; even. More change nothing before the eighth digit.
constexpr double kLongest = 1e12;

void require_process(const ChartedProcess& process) {
  if (!(process.spread > 0.0) || !std::isfinite(process.shift + process.spread))
    throw std::invalid_argument(fmt::format("run length: shift {}, spread {}; required: finite, a spread > 0",
                                            process.shift, process.spread));
}

/// A chain that hardly ever ends is singular to rounding.
double plausible(double length) {
  return std::isfinite(length) && length > 0.0 && length < kLongest ? length : HUGE_VAL;
}

/// Run length of the sum that grows with values above the allowance.
double one_sided_cusum(double allowance, double interval, double shift, double spread) {
  const double width = 2.0 * interval / (2.0 * static_cast<double>(kStates) - 1.0);
  // To go up by d states at most, d from -(kStates - 1) - 1/2.
  const auto below = [&](Eigen::Index d) {
    return normal_below(((static_cast<double>(d) + 0.5) * width + allowance - shift) / spread);
  };
  Eigen::VectorXd risen(2 * kStates);
  for (Eigen::Index d = -kStates; d < kStates; ++d) risen(d + kStates) = below(d);
  Eigen::MatrixXd q(kStates, kStates);
  for (Eigen::Index i = 0; i < kStates; ++i) {
    q(i, 0) = risen(kStates - i);  // State 0 also holds all sums that would be below it.
    for (Eigen::Index j = 1; j < kStates; ++j) q(i, j) = risen(kStates + j - i) - risen(kStates + j - i - 1);
  }
  const Eigen::MatrixXd left = Eigen::MatrixXd::Identity(kStates, kStates) - q;
  return plausible(solve_by_lu(left, Eigen::VectorXd::Ones(kStates))(0));
}

}  // namespace

double shewhart_run_length(double limit, const ChartedProcess& process) {
  require_process(process);
  return 1.0 / (normal_below((-limit - process.shift) / process.spread) +
                normal_below((-limit + process.shift) / process.spread));
}

double ewma_run_length(double weight, double limit, const ChartedProcess& process) {
  require_process(process);
  if (!(weight > 0.0 && weight <= 1.0))
    throw std::invalid_argument(
        fmt::format("run length: the weight is {}; required: above 0, at most 1", weight));
  using Nodes = boost::math::quadrature::gauss<double, kNodes>;
  const double edge = limit * std::sqrt(weight / (2.0 - weight));
  const double scale = weight * process.spread;
  // Averages at the nodes, and the weight of each in the integral.
  Eigen::VectorXd average(kNodes), part(kNodes);
  for (Eigen::Index i = 0; i < kNodes / 2; ++i) {
    const auto k = static_cast<std::size_t>(i);
    average(i) = edge * Nodes::abscissa()[k];
    average(kNodes - 1 - i) = -average(i);
    part(i) = part(kNodes - 1 - i) = edge * Nodes::weights()[k];
  }
  // How likely the average goes from one value to near a node.
  const auto step = [&](double from, Eigen::Index to) {
    const double z = (average(to) - (1.0 - weight) * from - weight * process.shift) / scale;
    return part(to) / scale * std::exp(-0.5 * z * z) * std::numbers::inv_sqrtpi / std::numbers::sqrt2;
  };
  Eigen::MatrixXd left = Eigen::MatrixXd::Identity(kNodes, kNodes);
  for (Eigen::Index i = 0; i < kNodes; ++i)
    for (Eigen::Index j = 0; j < kNodes; ++j) left(i, j) -= step(average(i), j);
  const Eigen::VectorXd lengths = solve_by_lu(left, Eigen::VectorXd::Ones(kNodes));
  double from_centre = 1.0;
  for (Eigen::Index j = 0; j < kNodes; ++j) from_centre += step(0.0, j) * lengths(j);
  return plausible(from_centre);
}

double cusum_run_length(double allowance, double interval, const ChartedProcess& process) {
  require_process(process);
  const double above = one_sided_cusum(allowance, interval, process.shift, process.spread);
  const double below = one_sided_cusum(allowance, interval, -process.shift, process.spread);
  return 1.0 / (1.0 / above + 1.0 / below);
}

}  // namespace abcal
