#include "app/results/export/temperature_constants.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/LU>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string_view>

#include "app/results/export/constants.h"
#include "app/system/output.h"
#include "drivers/text/letters.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kFirstOffset = 6;

double value_of(const std::vector<double>& coefficients, double d) {
  double value = 0.0;
  for (auto each = coefficients.rbegin(); each != coefficients.rend(); ++each) value = value * d + *each;
  return value;
}

/// Sensitivities at a distance from T0, R/g_loc.
Eigen::Matrix3d sensitivity_at(const std::vector<TemperaturePolynomial>& outputs, double d) {
  Eigen::Matrix<double, 6, 1> x;
  for (Eigen::Index k = 0; k < 6; ++k) x[k] = outputs.at(static_cast<std::size_t>(k)).at(d);
  return sensitivity_in_own_axes(x.head<3>(), x.tail<3>());
}

/// The elements of M as polynomials: least squares at Chebyshev's points of the range.
void fit_matrix(TemperatureConstants& c) {
  constexpr Eigen::Index kPoints = 41, kOrder = kMostTemperatureOrder;
  const double low = c.least_degc - c.reference_degc, high = c.most_degc - c.reference_degc;
  const double scale = std::max(std::abs(low), std::abs(high));
  Eigen::MatrixXd powers(kPoints, kOrder + 1), values(kPoints, 9);
  for (Eigen::Index n = 0; n < kPoints; ++n) {
    const double t =
        std::cos(std::numbers::pi * (static_cast<double>(n) + 0.5) / static_cast<double>(kPoints));
    const double d = 0.5 * (low + high) + 0.5 * (high - low) * t;
    for (Eigen::Index k = 0; k <= kOrder; ++k) powers(n, k) = std::pow(d / scale, k);
    const Eigen::Matrix3d M =
        c.g_loc_mps2 * sensitivity_at(c.outputs, d).partialPivLu().solve(Eigen::Matrix3d::Identity());
    for (Eigen::Index k = 0; k < 9; ++k) values(n, k) = M(k / 3, k % 3);
  }
  const Eigen::MatrixXd found = powers.colPivHouseholderQr().solve(values);
  for (Eigen::Index k = 0; k < 9; ++k)
    for (Eigen::Index n = 0; n <= kOrder; ++n)
      c.M[static_cast<std::size_t>(k)].push_back(found(n, k) * std::pow(scale, -n) + 0.0);  // No -0.
  constexpr int kSteps = 200;
  for (int n = 0; n <= kSteps; ++n) {
    const double degc = c.least_degc + (c.most_degc - c.least_degc) * n / kSteps;
    const Eigen::Matrix3d unit =
        c.matrix_at(degc) * sensitivity_at(c.outputs, degc - c.reference_degc) / c.g_loc_mps2;
    c.largest_error = std::max(c.largest_error, (unit - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff());
  }
}

std::string heading(const TemperatureConstants& c, std::string_view comment) {
  std::string text;
  const auto line = [&](const std::string& words) {
    text += fmt::format("{} {}\n", comment, printable_line(words));
  };
  line("Constants of an accelerometer over temperature, by abcal");
  if (!c.item.empty()) line("Item: " + c.item);
  line("From: " + c.source + (c.performed.empty() ? "" : ", " + c.performed) + ", verdict: " + c.verdict);
  line("Axes: x along the axis of u, y in the plane of u and v (not the platter of the stage)");
  line(fmt::format(
      "a = M(T) (r - b(T)): a in m/s2, readings r in {}, T in degC {}", c.response_unit,
      c.by_item ? "of the item's own sensor" : "as the chamber was set (the item has no sensor)"));
  line(fmt::format(
      "Each element is c[0] + c[1] d + c[2] d^2 ..., d = T - {:g} degC, for T from {:.1f} to {:.1f} degC",
      c.reference_degc, c.least_degc, c.most_degc));
  line(fmt::format("The polynomials of M agree with the inverse of the sensitivities to {:.1g}",
                   c.largest_error));
  return text;
}

Json json_of(const TemperaturePolynomial& p) {
  Json covariance = Json::array();
  for (Eigen::Index i = 0; i < p.covariance.rows(); ++i) {
    std::vector<double> row;
    for (Eigen::Index k = 0; k < p.covariance.cols(); ++k) row.push_back(p.covariance(i, k));
    covariance.push_back(row);
  }
  return {{"name", p.name}, {"unit", p.unit}, {"coefficients", p.coefficient}, {"covariance", covariance}};
}

}  // namespace

Eigen::Matrix3d TemperatureConstants::matrix_at(double degc) const {
  Eigen::Matrix3d matrix;
  for (std::size_t k = 0; k < M.size(); ++k)
    matrix(static_cast<Eigen::Index>(k / 3), static_cast<Eigen::Index>(k % 3)) =
        value_of(M[k], degc - reference_degc);
  return matrix;
}

Eigen::Vector3d TemperatureConstants::offset_at(double degc) const {
  Eigen::Vector3d bias;
  for (std::size_t j = 0; j < 3; ++j)
    bias[static_cast<Eigen::Index>(j)] = outputs.at(kFirstOffset + j).at(degc - reference_degc);
  return bias;
}

TemperatureConstants temperature_constants(const TemperatureResult& result, double g_loc_mps2) {
  TemperatureConstants constants;
  constants.outputs = result.polynomials;
  constants.reference_degc = result.reference_degc;
  constants.by_item = result.by_item();
  constants.least_degc = result.least_degc;
  constants.most_degc = result.most_degc;
  constants.g_loc_mps2 = g_loc_mps2;
  fit_matrix(constants);
  return constants;
}

std::string temperature_constants_json(const TemperatureConstants& c) {
  Json matrix = Json::array(), bias = Json::array(), outputs = Json::array();
  for (std::size_t j = 0; j < 3; ++j) matrix.push_back({c.M[3 * j], c.M[3 * j + 1], c.M[3 * j + 2]});
  for (const TemperaturePolynomial& each : c.outputs) outputs.push_back(json_of(each));
  for (std::size_t j = kFirstOffset; j < c.outputs.size(); ++j) bias.push_back(c.outputs[j].coefficient);
  const Json json{{"schema", "abcal.temperature_constants/1"},
                  {"rule", "a = M(T) (r - b(T)); each element is sum c[n] (T - T0)^n"},
                  {"item", c.item},
                  {"source", c.source},
                  {"performed", c.performed},
                  {"verdict", c.verdict},
                  {"frame", "item"},
                  {"response_unit", c.response_unit},
                  {"g_loc_mps2", c.g_loc_mps2},
                  {"T0_degc", c.reference_degc},
                  {"least_degc", c.least_degc},
                  {"most_degc", c.most_degc},
                  {"M",
                   {{"coefficients", matrix},
                    {"largest_error", c.largest_error},
                    {"unit", "m/s2 per response unit / K^n"}}},
                  {"b", {{"coefficients", bias}, {"unit", "response unit / K^n"}}},
                  {"outputs", outputs}};
  return printable_text(json.dump(2)) + "\n";
}

std::string temperature_constants_csv(const TemperatureConstants& c) {
  std::string text = heading(c, "#") +
                     "# M has no uncertainty of its own: that of s and phi, from which it is made, is below\n"
                     "name,n,coefficient,standard_uncertainty\n";
  for (std::size_t k = 0; k < c.M.size(); ++k)
    for (std::size_t n = 0; n < c.M[k].size(); ++n)
      text += fmt::format("M_{}{},{},{},\n", kPlatterAxes[k / 3], kOutputNames[k % 3], n, c.M[k][n]);
  const auto add = [&](const std::string& name, const TemperaturePolynomial& p) {
    for (std::size_t n = 0; n < p.coefficient.size(); ++n) {
      const auto i = static_cast<Eigen::Index>(n);
      text += fmt::format("{},{},{},{}\n", name, n, p.coefficient[n], std::sqrt(p.covariance(i, i)));
    }
  };
  for (std::size_t j = 0; j < 3; ++j)
    add(fmt::format("b_{}", kOutputNames[j]), c.outputs.at(kFirstOffset + j));
  for (std::size_t k = 0; k < kFirstOffset; ++k) add(c.outputs.at(k).name, c.outputs[k]);
  return text;
}

std::string temperature_constants_c(const TemperatureConstants& c) {
  std::size_t terms = 1;
  for (const std::vector<double>& each : c.M) terms = std::max(terms, each.size());
  const auto row = [&](std::vector<double> coefficients) {
    coefficients.resize(terms, 0.0);
    return fmt::format("{{{:.9g}}}", fmt::join(coefficients, ", "));
  };
  std::string matrix, bias;
  for (std::size_t j = 0; j < 3; ++j) {
    matrix += fmt::format("    {{{},\n     {},\n     {}}},\n", row(c.M[3 * j]), row(c.M[3 * j + 1]),
                          row(c.M[3 * j + 2]));
    bias += fmt::format("    {},\n", row(c.outputs.at(kFirstOffset + j).coefficient));
  }
  return heading(c, "//") +
         fmt::format(
             "#ifndef ABCAL_TEMPERATURE_CONSTANTS_H\n#define ABCAL_TEMPERATURE_CONSTANTS_H\n\n"
             "enum {{ abcal_terms = {} }};\n"
             "static const double abcal_T0_degc = {:.9g}, abcal_least_degc = {:.9g}, abcal_most_degc = "
             "{:.9g};\n"
             "static const double abcal_M[3][3][{}] = {{\n{}}};\nstatic const double abcal_b[3][{}] = "
             "{{\n{}}};\n\n"
             "#endif\n",
             terms, c.reference_degc, c.least_degc, c.most_degc, terms, matrix, terms, bias);
}

}  // namespace abcal
