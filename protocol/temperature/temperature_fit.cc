#include "protocol/temperature/temperature_fit.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "protocol/linear/cholesky.h"
#include "protocol/linear/products.h"
#include "protocol/quantities/output_names.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// 95 % of chi2 with one degree of freedom, and with two.
constexpr double kOneMore = 3.841, kTwoMore = 5.991;
/// Temperatures nearer than this are one: order of a polynomial, ways up and down.
constexpr double kSameTemperatureK = 2.0;
constexpr double kMillion = 1e6;
/// Constants of the stage that a run determines, with the unit of a trend.
constexpr std::array<std::pair<const char*, const char*>, 5> kStage{
    {{"Zx", "1"}, {"Zy", "1"}, {"Xz", "1"}, {"d2", "degree"}, {"d3", "degree"}}};
/// A trend of the stage is found by chance in one series of a thousand, for each constant.
constexpr double kTrendByChance = 1e-3;

/// One output at all points, with d = (T - T0) / scale.
struct Series {
  Eigen::VectorXd d, value, own_variance;
  Eigen::VectorXd shared;  ///< Standard uncertainties that all points share, with their sign.
  double scale = 1.0;
};

struct Solution {
  Eigen::VectorXd coefficient;
  Eigen::MatrixXd covariance, excess_covariance;
  Eigen::VectorXd residual;
  double chi2 = 0.0;
};

Eigen::MatrixXd design(const Eigen::VectorXd& d, int order) {
  Eigen::MatrixXd rows(d.size(), order + 1);
  for (int n = 0; n <= order; ++n) rows.col(n) = d.array().pow(n);
  return rows;
}

Solution solve(const Series& series, int order, double excess_variance) {
  Eigen::MatrixXd v = series.shared * series.shared.transpose();
  v.diagonal() += series.own_variance + Eigen::VectorXd::Constant(series.d.size(), excess_variance);
  const Cholesky factor(v);
  const Eigen::MatrixXd a = factor.solve_lower(design(series.d, order));
  const Eigen::VectorXd y = factor.solve_lower_vector(series.value);
  Solution solution;
  solution.covariance = PivotedCholesky(transposed_product(a, a)).inverse();
  solution.coefficient = product_with_vector(solution.covariance, transposed_product_with_vector(a, y));
  const Eigen::MatrixXd weights = factor.solve_upper(product(a, solution.covariance));
  solution.excess_covariance = excess_variance * transposed_product(weights, weights);
  solution.residual = series.value - product_with_vector(design(series.d, order), solution.coefficient);
  solution.chi2 = (y - product_with_vector(a, solution.coefficient)).squaredNorm();
  return solution;
}

/// The variance that reduces chi2 to its degrees of freedom (Paule and Mandel); 0 if it is already there.
double excess_variance(const Series& series, int order) {
  const auto degrees = static_cast<double>(series.d.size() - order - 1);
  if (degrees < 1.0 || solve(series, order, 0.0).chi2 <= degrees) return 0.0;
  double least = 0.0, most = series.own_variance.maxCoeff();
  while (solve(series, order, most).chi2 > degrees) most *= 4.0;
  for (int n = 0; n < 60; ++n) {
    const double middle = 0.5 * (least + most);
    (solve(series, order, middle).chi2 > degrees ? least : most) = middle;
  }
  return most;
}

/// How many temperatures there are that differ.
int distinct(const std::vector<TemperaturePoint>& points) {
  std::vector<double> all;
  for (const TemperaturePoint& point : points) all.push_back(point.temperature_degc);
  std::sort(all.begin(), all.end());
  int count = 0;
  double last = -1e9;
  for (const double each : all) {
    if (each - last > kSameTemperatureK) {
      ++count;
      last = each;
    }
  }
  return count;
}

/// The order by likelihood ratios, all with the scatter that the highest order leaves.
int choose_order(const Series& series, int most, double variance, std::vector<double>& ratios) {
  std::vector<double> chi2;
  for (int order = 0; order <= most; ++order) chi2.push_back(solve(series, order, variance).chi2);
  const auto drop = [&](int from, int to) {
    return chi2[static_cast<std::size_t>(from)] - chi2[static_cast<std::size_t>(to)];
  };
  int order = 0;
  while (order < most) {
    ratios.push_back(drop(order, order + 1));
    if (ratios.back() > kOneMore) {
      ++order;
    } else if (order + 2 <= most && drop(order, order + 2) > kTwoMore) {
      ratios.push_back(drop(order + 1, order + 2));
      order += 2;
    } else {
      break;
    }
  }
  return order;
}

std::string unit_of(std::size_t k, const std::string& response_unit) {
  return k < 3 ? response_unit + "/g_loc" : k < 6 ? "degree" : response_unit;
}

void scale(Series& series) {
  series.scale = std::max(1.0, series.d.cwiseAbs().maxCoeff());
  series.d /= series.scale;
  // Readings without any scatter (a noiseless simulation): round-off is left.
  const double least = 1e-12 * std::max(1.0, series.value.cwiseAbs().maxCoeff());
  series.own_variance = series.own_variance.cwiseMax(least * least);
}

Series series_of(const std::vector<TemperaturePoint>& points, double reference_degc, Eigen::Index k) {
  const auto count = static_cast<Eigen::Index>(points.size());
  Series series;
  series.d.resize(count);
  series.value.resize(count);
  series.own_variance.resize(count);
  series.shared.resize(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const TemperaturePoint& point = points[static_cast<std::size_t>(i)];
    series.d[i] = point.temperature_degc - reference_degc;
    series.value[i] = point.value[k];
    series.own_variance[i] = point.own(k, k);
    series.shared[i] = std::sqrt(std::max(0.0, point.shared(k, k)));
  }
  // Within a run the item changes a little; which of these temperatures a value belongs to is not known.
  const Eigen::VectorXd from_mean = series.d.array() - series.d.mean();
  const double slope = from_mean.dot(series.value) / from_mean.squaredNorm();
  for (Eigen::Index i = 0; i < count; ++i) {
    const double change = slope * points[static_cast<std::size_t>(i)].change_k;
    series.own_variance[i] += change * change / 12.0;
  }
  scale(series);
  return series;
}

/// The polynomial of one order.
TemperaturePolynomial polynomial_of(const Series& series, int order) {
  TemperaturePolynomial polynomial;
  polynomial.order = order;
  polynomial.chi2 = solve(series, order, 0.0).chi2;
  polynomial.degrees_of_freedom = static_cast<int>(series.d.size()) - order - 1;
  const double variance = excess_variance(series, order);
  polynomial.excess = std::sqrt(variance);
  const Solution solution = solve(series, order, variance);
  // From the scaled abscissa to kelvin.
  Eigen::VectorXd by(order + 1);
  for (int n = 0; n <= order; ++n) by[n] = std::pow(series.scale, -n);
  polynomial.covariance = scaled_on_both_sides(solution.covariance, by);
  polynomial.excess_covariance = scaled_on_both_sides(solution.excess_covariance, by);
  for (int n = 0; n <= order; ++n) polynomial.coefficient.push_back(solution.coefficient[n] * by[n]);
  polynomial.residual.assign(solution.residual.data(), solution.residual.data() + solution.residual.size());
  polynomial.residual_rms = std::sqrt(solution.residual.squaredNorm() / static_cast<double>(series.d.size()));
  polynomial.residual_max = solution.residual.cwiseAbs().maxCoeff();
  return polynomial;
}

/// The polynomial of the order that the likelihood ratios choose.
TemperaturePolynomial chosen_polynomial(const Series& series, int most_order) {
  std::vector<double> ratios;
  const int order = choose_order(series, most_order, excess_variance(series, most_order), ratios);
  TemperaturePolynomial polynomial = polynomial_of(series, order);
  polynomial.likelihood_ratio = std::move(ratios);
  return polynomial;
}

Eigen::VectorXd powers_of(double from_t0, int order) {
  Eigen::VectorXd powers(order + 1);
  for (int n = 0; n <= order; ++n) powers[n] = std::pow(from_t0, n);
  return powers;
}

/// Coefficient in the units of data sheets: sensitivities in ppm/K, offsets in millionths of g_loc, angles in
/// microradian.
TemperatureCoefficient coefficient_of(const TemperaturePolynomial& polynomial, std::size_t k,
                                      double sensitivity, double from, double to) {
  TemperatureCoefficient found;
  found.name = polynomial.name;
  const double factor = k >= 3 && k < 6 ? kMillion * std::numbers::pi / 180.0 : kMillion / sensitivity;
  found.unit = k < 3 ? "ppm/K" : k < 6 ? "urad/K" : "ug/K";
  const auto uncertainty = [&](const Eigen::VectorXd& weights) {
    return std::abs(factor) * std::sqrt(std::max(0.0, weights.dot(polynomial.covariance * weights)));
  };
  const Eigen::VectorXd slope = Eigen::VectorXd::Unit(polynomial.order + 1, 1);
  found.at_reference = factor * polynomial.coefficient[1];
  found.standard_uncertainty = uncertainty(slope);
  found.degrees_of_freedom = polynomial.degrees_of_freedom_of(slope);
  constexpr int kSteps = 200;
  double lowest = from, highest = from;
  for (int n = 1; n <= kSteps; ++n) {
    const double d = from + (to - from) * n / kSteps;
    if (polynomial.at(d) < polynomial.at(lowest)) lowest = d;
    if (polynomial.at(d) > polynomial.at(highest)) highest = d;
  }
  const auto between = [&](double a, double b) -> Eigen::VectorXd {
    return (powers_of(b, polynomial.order) - powers_of(a, polynomial.order)) / (to - from);
  };
  const Eigen::VectorXd box = between(lowest, highest), ends = between(from, to);
  found.box = std::abs(factor) * (polynomial.at(highest) - polynomial.at(lowest)) / (to - from);
  found.box_uncertainty = uncertainty(box);
  found.box_degrees_of_freedom = polynomial.degrees_of_freedom_of(box);
  found.end_point = factor * (polynomial.at(to) - polynomial.at(from)) / (to - from);
  found.end_point_uncertainty = uncertainty(ends);
  found.end_point_degrees_of_freedom = polynomial.degrees_of_freedom_of(ends);
  return found;
}

/// Two-sided probability of a slope this many standard uncertainties from zero.
double probability_of(double slope, double standard_uncertainty, double degrees_of_freedom) {
  return 2.0 * student_t_tail(std::abs(slope) / standard_uncertainty, degrees_of_freedom);
}

StageTrend trend_of(const std::vector<TemperaturePoint>& points, double reference_degc, std::size_t k) {
  const auto count = static_cast<Eigen::Index>(points.size());
  Series series{Eigen::VectorXd(count), Eigen::VectorXd(count), Eigen::VectorXd(count),
                Eigen::VectorXd::Zero(count)};
  for (Eigen::Index i = 0; i < count; ++i) {
    const TemperaturePoint& point = points[static_cast<std::size_t>(i)];
    const Quantity& found = point.stage->at(k);
    series.d[i] = point.temperature_degc - reference_degc;
    series.value[i] = found.value;
    // Only type A counts here, because type B errors are the same at all points.
    const double u = found.type_a.value_or(found.standard_uncertainty);
    series.own_variance[i] = u * u;
  }
  scale(series);
  const TemperaturePolynomial line = polynomial_of(series, 1);
  StageTrend trend;
  trend.name = kStage[k].first;
  trend.unit = kStage[k].second;
  trend.slope = line.coefficient[1];
  trend.standard_uncertainty = std::sqrt(line.covariance(1, 1));
  trend.probability = probability_of(trend.slope, trend.standard_uncertainty,
                                     line.degrees_of_freedom_of(Eigen::VectorXd::Unit(2, 1)));
  return trend;
}

/// Only if every run estimated the stage on its own, and there are enough points to test a line.
std::vector<StageTrend> stage_trends(const std::vector<TemperaturePoint>& points, double reference_degc) {
  constexpr std::size_t kLeastPoints = 4;
  std::vector<StageTrend> trends;
  const bool found = std::all_of(points.begin(), points.end(),
                                 [](const TemperaturePoint& point) { return point.stage.has_value(); });
  if (!found || points.size() < kLeastPoints) return trends;
  for (std::size_t k = 0; k < kStage.size(); ++k) trends.push_back(trend_of(points, reference_degc, k));
  return trends;
}

TemperatureHysteresis hysteresis_of(const std::vector<TemperaturePoint>& points,
                                    const TemperaturePolynomial& polynomial, Eigen::Index k,
                                    double reference) {
  TemperatureHysteresis found;
  found.name = polynomial.name;
  found.unit = polynomial.unit;
  // Both values are corrected to one temperature, so that the polynomial between them does not count as
  // hysteresis.
  const auto difference = [&](const TemperaturePoint& a, const TemperaturePoint& b) {
    return a.value[k] - b.value[k] - polynomial.at(a.temperature_degc - reference) +
           polynomial.at(b.temperature_degc - reference);
  };
  const auto uncertainty = [&](const TemperaturePoint& a, const TemperaturePoint& b) {
    return std::sqrt(a.own(k, k) + b.own(k, k));
  };
  for (const TemperaturePoint& up : points) {
    if (up.leg != SeriesLeg::kUp) continue;
    for (const TemperaturePoint& down : points) {
      if (down.leg != SeriesLeg::kDown || down.set_degc != up.set_degc) continue;
      const double d = difference(up, down);
      if (found.has_both_ways && std::abs(d) <= std::abs(found.largest)) continue;
      found.has_both_ways = true;
      found.largest = d;
      found.standard_uncertainty = uncertainty(up, down);
      found.at_degc = up.set_degc;
    }
  }
  const TemperaturePoint& first = points.front();
  const TemperaturePoint& last = points.back();
  found.has_closure = first.leg == SeriesLeg::kReference && last.leg == SeriesLeg::kReturn;
  if (found.has_closure) {
    found.closure = difference(last, first);
    found.closure_uncertainty = uncertainty(last, first);
  }
  return found;
}

}  // namespace

double TemperaturePolynomial::at(double from_t0) const {
  double value = 0.0;
  for (auto each = coefficient.rbegin(); each != coefficient.rend(); ++each) value = value * from_t0 + *each;
  return value;
}

double TemperaturePolynomial::standard_uncertainty_at(double from_t0) const {
  const Eigen::VectorXd powers = powers_of(from_t0, order);
  return std::sqrt(std::max(0.0, powers.dot(covariance * powers)));
}

double TemperaturePolynomial::degrees_of_freedom_of(const Eigen::VectorXd& weights) const {
  const double all = weights.dot(covariance * weights), of_excess = weights.dot(excess_covariance * weights);
  if (!(of_excess > 0.0)) return std::numeric_limits<double>::infinity();
  return degrees_of_freedom * (all / of_excess) * (all / of_excess);
}

double TemperaturePolynomial::slope_at(double from_t0) const {
  double slope = 0.0;
  for (int n = 1; n <= order; ++n)
    slope += n * coefficient[static_cast<std::size_t>(n)] * std::pow(from_t0, n - 1);
  return slope;
}

bool StageTrend::constant() const {
  return probability >= kTrendByChance;
}

bool TemperatureResult::by_item() const {
  return std::all_of(points.begin(), points.end(),
                     [](const TemperaturePoint& point) { return point.by_item; });
}

std::vector<std::string> TemperatureResult::reasons() const {
  std::vector<std::string> reasons;
  std::vector<int> doubtful;
  for (const TemperaturePoint& point : points)
    if (point.verdict != Verdict::kUsable) doubtful.push_back(point.number);
  if (!doubtful.empty())
    reasons.push_back(fmt::format("points {} are not usable: see their verdicts", fmt::join(doubtful, ", ")));
  for (const StageTrend& trend : stage)
    if (!trend.constant())
      reasons.push_back(fmt::format(
          "the stage changes with temperature: {} by {:.2g}{} per kelvin (standard uncertainty {:.1g}), "
          "while what all points share is taken as constant",
          trend.name, trend.slope, trend.unit == "1" ? "" : " " + trend.unit, trend.standard_uncertainty));
  return reasons;
}

TemperaturePoint temperature_point(const CalibrationResult& result) {
  if (!result.covariance_intrinsic || result.verdict == Verdict::kNotUsable)
    throw std::invalid_argument(
        fmt::format("{}: no covariance of its intrinsic outputs ({})", result.source, result.why));
  TemperaturePoint point;
  for (int j = 0; j < 3; ++j) {
    const auto n = static_cast<std::size_t>(j);
    point.value[j] = result.intrinsic_sensitivity[n].value;
    point.value[3 + j] = result.intrinsic_angle[n].value;
    point.value[6 + j] = result.offset[n].value;
  }
  const Covariance9 none = Covariance9::Zero();
  point.own = result.covariance_intrinsic_type_a.value_or(*result.covariance_intrinsic);
  point.shared =
      result.covariance_intrinsic_type_a ? result.covariance_intrinsic_type_b.value_or(none) : none;
  point.verdict = result.verdict;
  if (const auto& joint = result.joint)
    point.stage = {joint->alignment[0], joint->alignment[1], joint->alignment[2],
                   joint->initial_turn_error[0], joint->initial_turn_error[1]};
  return point;
}

TemperatureResult fit_temperature(std::vector<TemperaturePoint> points, double reference_degc,
                                  const std::string& response_unit) {
  const int temperatures = distinct(points);
  if (temperatures < 2)
    throw std::invalid_argument(
        fmt::format("a series with {} temperatures of the item that differ by more than {:g} K; required: 2",
                    temperatures, kSameTemperatureK));
  TemperatureResult result;
  result.reference_degc = reference_degc;
  const auto [least, most] = std::minmax_element(
      points.begin(), points.end(),
      [](const auto& a, const auto& b) { return a.temperature_degc < b.temperature_degc; });
  result.least_degc = least->temperature_degc;
  result.most_degc = most->temperature_degc;
  result.points = std::move(points);
  const int most_order =
      std::min({kMostTemperatureOrder, temperatures - 1, static_cast<int>(result.points.size()) - 2});
  std::vector<TemperaturePolynomial> of_coefficients;
  for (std::size_t k = 0; k < kIntrinsicSymbols.size(); ++k) {
    const auto index = static_cast<Eigen::Index>(k);
    const Series series = series_of(result.points, reference_degc, index);
    TemperaturePolynomial polynomial = chosen_polynomial(series, std::max(0, most_order));
    polynomial.name = kIntrinsicSymbols[k];
    polynomial.unit = unit_of(k, response_unit);
    // No slope is a value, too, and it has an uncertainty.
    of_coefficients.push_back(polynomial.order > 0 ? polynomial : polynomial_of(series, 1));
    of_coefficients.back().name = polynomial.name;
    result.hysteresis.push_back(hysteresis_of(result.points, polynomial, index, reference_degc));
    result.polynomials.push_back(std::move(polynomial));
  }
  for (std::size_t k = 0; k < kIntrinsicSymbols.size(); ++k) {
    result.coefficients.push_back(
        coefficient_of(of_coefficients[k], k, result.polynomials[k % 3].coefficient[0],
                       result.least_degc - reference_degc, result.most_degc - reference_degc));
  }
  result.stage = stage_trends(result.points, reference_degc);
  return result;
}

}  // namespace abcal
