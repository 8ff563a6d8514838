#include "app/laboratory/certificate/dsi_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>

#include "app/document/number_text.h"
#include "app/formats/dsi_unit.h"
#include "app/results/analysis/report_data.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// D-SI allows no exponent here, and nothing below 1.
std::string factor_text(double factor, std::string_view what) {
  if (!std::isfinite(factor)) throw NumberNotFinite(fmt::format("{} is not a finite number", what));
  return fmt::format("{:.2f}", factor);
}

std::string probability_text() {
  return fmt::format("{:.4f}", kCoverageProbability);
}

/// The distribution of which k is that of kCoverageProbability.
std::string distribution_text(double degrees_of_freedom) {
  return std::isfinite(degrees_of_freedom) ? "Student" : "normal";
}

/// Texts one blank apart, as lists of XML schema are.
std::string listed(Eigen::Index count, const std::function<std::string(Eigen::Index)>& text) {
  std::string list;
  for (Eigen::Index i = 0; i < count; ++i) list += (i == 0 ? "" : " ") + text(i);
  return list;
}

/// A text that is the same for all values is given once, as the business rules require.
std::string once_or_listed(const std::vector<std::string>& texts) {
  if (std::adjacent_find(texts.begin(), texts.end(), std::not_equal_to<>()) == texts.end())
    return texts.front();
  return listed(static_cast<Eigen::Index>(texts.size()),
                [&](Eigen::Index i) { return texts[static_cast<std::size_t>(i)]; });
}

/// Digits of covariances: more than of the values, so that the matrix stays positive definite.
std::string covariance_number(double value, const std::string& what) {
  if (!std::isfinite(value)) throw NumberNotFinite(fmt::format("{} is not a finite number", what));
  return fmt::format("{:.8g}", value);
}

/// One representation of a list: all in one unit of D-SI.
struct Representation {
  std::vector<std::string> labels;
  DsiUnit unit;
  double scale = 1.0;  ///< Values are multiplied by this.
};

void add_covariance(XmlElement& parent, const ValueList& list, const Representation& as) {
  const Eigen::Index n = list.values.size();
  XmlElement region =
      parent.add("si:measurementUncertaintyMultivariateXMLList").add("si:ellipsoidalRegionMUXMLList");
  XmlElement matrix = region.add("si:covarianceMatrixXMLList");
  const auto label_of = [&](Eigen::Index i) { return as.labels[static_cast<std::size_t>(i)]; };
  for (Eigen::Index column = 0; column < n; ++column) {
    XmlElement values = matrix.add("si:columnXMLList").add("si:covarianceXMLList");
    values.add("si:valueXMLList", listed(n, [&](Eigen::Index row) {
                 return covariance_number(
                     (*list.covariance)(row, column) * as.scale * as.scale,
                     fmt::format("covariance of {} and {}", label_of(row), label_of(column)));
               }));
    values.add("si:unitXMLList", (as.unit * as.unit).text());
  }
  const std::string factor =
      fmt::format("{:.6f}", ellipsoid_factor(static_cast<int>(n), kCoverageProbability));
  region.add("si:coverageFactorXMLList", factor);
  region.add("si:coverageProbabilityXMLList", probability_text());
  region.add("si:distributionXMLList", "normal");
}

void add_real_list(XmlElement& parent, const ValueList& list, const Representation& as) {
  const Eigen::Index n = list.values.size();
  std::vector<std::string> values, expanded, places, factors, distributions;
  for (Eigen::Index i = 0; i < n; ++i) {
    const std::string& label = as.labels[static_cast<std::size_t>(i)];
    const double own = list.coverage_factor[i] * list.standard_uncertainty[i];
    const RoundedValue rounded = rounded_value(list.values[i] * as.scale, own * std::abs(as.scale), label);
    values.push_back(list.all_digits ? dsi_number(list.values[i] * as.scale, label) : rounded.value);
    expanded.push_back(rounded.expanded);
    if (rounded.place && !list.all_digits) places.push_back(fmt::format("{}", *rounded.place));
    factors.push_back(factor_text(list.coverage_factor[i], "coverage factor of " + label));
    distributions.push_back(distribution_text(list.degrees_of_freedom[i]));
  }
  const auto join = [&](const std::vector<std::string>& texts) {
    return listed(n, [&](Eigen::Index i) { return texts[static_cast<std::size_t>(i)]; });
  };
  XmlElement real = parent.add("si:realListXMLList");
  real.add("si:labelXMLList", join(as.labels));
  real.add("si:valueXMLList", join(values));
  real.add("si:unitXMLList", as.unit.text());
  if (places.size() == values.size()) real.add("si:significantDigitXMLList", once_or_listed(places));
  XmlElement uncertainty = real.add("si:measurementUncertaintyUnivariateXMLList").add("si:expandedMUXMLList");
  uncertainty.add("si:valueExpandedMUXMLList", join(expanded));
  uncertainty.add("si:coverageFactorXMLList", once_or_listed(factors));
  uncertainty.add("si:coverageProbabilityXMLList", probability_text());
  uncertainty.add("si:distributionXMLList", once_or_listed(distributions));
  if (list.covariance) add_covariance(real, list, as);
}

void add_real(XmlElement& parent, const Quantity& value, double scale, const DsiUnit& unit,
              std::string_view what) {
  XmlElement real = parent.add("si:real");
  const double scaled = value.value * scale;
  if (std::isnan(value.standard_uncertainty)) {  // No uncertainty was evaluated.
    real.add("si:value", dsi_number(scaled, what));
    real.add("si:unit", unit.text());
    return;
  }
  const double factor = coverage_factor(value);
  const std::string factor_words = factor_text(factor, "coverage factor of " + std::string(what));
  const RoundedValue rounded =
      rounded_value(scaled, factor * value.standard_uncertainty * std::abs(scale), what);
  real.add("si:value", rounded.value);
  real.add("si:unit", unit.text());
  if (rounded.place) real.add("si:significantDigit", fmt::format("{}", *rounded.place));
  XmlElement expanded = real.add("si:measurementUncertaintyUnivariate").add("si:expandedMU");
  expanded.add("si:valueExpandedMU", rounded.expanded);
  expanded.add("si:coverageFactor", factor_words);
  expanded.add("si:coverageProbability", probability_text());
  expanded.add("si:distribution", distribution_text(value.degrees_of_freedom));
}

/// Largest exponents of ten that are written as plain decimals.
constexpr int kMostDecimals = 9;
constexpr double kLeastPlain = 1e-4;

/// The exponent of a text that has one.
int exponent_of(const std::string& text) {
  const char* begin = text.data() + text.find('e') + 1;
  int exponent = 0;
  std::from_chars(begin + (*begin == '+' ? 1 : 0), text.data() + text.size(), exponent);
  return exponent;
}

/// With an exponent, so that the last digit has the place (a power of ten).
std::string with_exponent(double value, int place) {
  if (value == 0.0) return "0";
  constexpr int kAllDigits = 16;
  const int exponent = exponent_of(fmt::format("{:e}", value));
  if (exponent < place) {  // Less than one of the last digit.
    const bool rounds_up = exponent == place - 1 && std::abs(value) * std::pow(10.0, -place) >= 0.5;
    return rounds_up ? fmt::format("{}1e{:+03d}", value < 0.0 ? "-" : "", place) : "0";
  }
  const int digits = std::min(exponent - place, kAllDigits);
  std::string text = fmt::format("{:.{}e}", value, digits);
  if (exponent_of(text) == exponent || digits == kAllDigits) return text;
  // 9.9996 became 10.000: one digit more before the last place.
  double rounded = 0.0;
  std::from_chars(text.data(), text.data() + text.size(), rounded);
  return fmt::format("{:.{}e}", rounded, digits + 1);
}

}  // namespace

std::string dsi_number(double value, std::string_view what) {
  if (!std::isfinite(value)) throw NumberNotFinite(fmt::format("{} is not a finite number", what));
  return fmt::format("{:.12g}", value == 0.0 ? 0.0 : value);
}

RoundedValue rounded_value(double value, double expanded, std::string_view what) {
  if (!std::isfinite(value)) throw NumberNotFinite(fmt::format("{} is not a finite number", what));
  if (!std::isfinite(expanded))
    throw NumberNotFinite(fmt::format("uncertainty of {} is not a finite number", what));
  if (expanded < 0.0) throw std::invalid_argument(fmt::format("uncertainty of {} is negative", what));
  if (expanded == 0.0) return {dsi_number(value, what), "0", std::nullopt};
  const int place = place_of_second_digit(expanded);
  RoundedValue rounded;
  rounded.place = place;
  const double larger = std::max(std::abs(value), expanded);
  if (place <= 0 && -place <= kMostDecimals && larger >= kLeastPlain) {
    rounded.value = fmt::format("{:.{}f}", value, -place);
    rounded.expanded = fmt::format("{:.{}f}", expanded, -place);
    if (rounded.value.find_first_of("123456789") == std::string::npos && rounded.value.front() == '-')
      rounded.value.erase(0, 1);
    return rounded;
  }
  rounded.value = with_exponent(value, place);
  rounded.expanded = fmt::format("{:.1e}", expanded);
  return rounded;
}

RoundedValue printed_in_si(const Quantity& quantity, std::string_view what) {
  const double scale = unit_in_dsi(quantity.unit).factor;
  const double expanded = coverage_factor(quantity) * quantity.standard_uncertainty;
  return rounded_value(quantity.value * scale, expanded * std::abs(scale), what);
}

double ellipsoid_factor(int dimensions, double probability) {
  return std::sqrt(chi2_quantile(probability, dimensions));
}

ValueList list_of(const std::vector<std::string>& labels, const std::vector<Quantity>& quantities,
                  std::optional<Eigen::MatrixXd> covariance) {
  ValueList list;
  list.labels = labels;
  list.unit = quantities.front().unit;
  const auto n = static_cast<Eigen::Index>(quantities.size());
  for (Eigen::VectorXd* vector :
       {&list.values, &list.standard_uncertainty, &list.coverage_factor, &list.degrees_of_freedom})
    vector->resize(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Quantity& quantity = quantities[static_cast<std::size_t>(i)];
    list.values[i] = quantity.value;
    list.standard_uncertainty[i] = quantity.standard_uncertainty;
    list.coverage_factor[i] = coverage_factor(quantity);
    list.degrees_of_freedom[i] = quantity.degrees_of_freedom;
    if (unit_in_dsi(quantity.unit).unit.text() != unit_in_dsi(list.unit).unit.text())
      throw std::logic_error("a list in " + list.unit + " and in " + quantity.unit);
  }
  list.covariance = std::move(covariance);
  return list;
}

void add_value_list(XmlElement& quantity, const ValueList& list) {
  const UnitInDsi in = unit_in_dsi(list.unit);
  const Representation si{list.labels, in.unit, in.factor};
  if (!in.own) return add_real_list(quantity, list, si);
  Representation own{{}, *in.own, 1.0};
  // A reader that knows only SI units finds each label once.
  for (const std::string& label : list.labels) own.labels.push_back(label + "[" + own.unit.text() + "]");
  XmlElement both = quantity.add("si:hybrid");
  add_real_list(both, list, si);
  add_real_list(both, list, own);
}

void add_number_list(XmlElement& quantity, const std::vector<std::string>& labels,
                     const std::vector<std::string>& numbers, const std::string& unit) {
  const auto n = static_cast<Eigen::Index>(labels.size());
  XmlElement real = quantity.add("si:realListXMLList");
  real.add("si:labelXMLList", listed(n, [&](Eigen::Index i) { return labels[static_cast<std::size_t>(i)]; }));
  real.add("si:valueXMLList",
           listed(n, [&](Eigen::Index i) { return numbers[static_cast<std::size_t>(i)]; }));
  real.add("si:unitXMLList", unit);
}

void add_value(XmlElement& quantity, const Quantity& value, std::string_view what) {
  const UnitInDsi in = unit_in_dsi(value.unit);
  if (!in.own) return add_real(quantity, value, in.factor, in.unit, what);
  XmlElement both = quantity.add("si:hybrid");
  add_real(both, value, in.factor, in.unit, what);
  add_real(both, value, 1.0, *in.own, what);
}

}  // namespace abcal
