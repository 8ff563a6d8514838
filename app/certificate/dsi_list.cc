#include "app/certificate/dsi_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/math/distributions/chi_squared.hpp>
#include <cmath>
#include <functional>

#include "app/results/report_data.h"
#include "app/units/dsi_unit.h"

namespace abcal {
namespace {

/// D-SI allows no exponent here, and nothing below 1.
std::string factor_text(double factor) {
  return fmt::format("{:.6f}", factor);
}

std::string probability_text() {
  return fmt::format("{}", kCoverageProbability);
}

/// Texts one blank apart, as lists of XML schema are.
std::string listed(Eigen::Index count, const std::function<std::string(Eigen::Index)>& text) {
  std::string list;
  for (Eigen::Index i = 0; i < count; ++i) list += (i == 0 ? "" : " ") + text(i);
  return list;
}

/// One representation of a list: all in units of D-SI.
struct Representation {
  std::vector<std::string> labels;
  std::vector<DsiUnit> units;
  Eigen::VectorXd scale;  ///< Values are multiplied by this.
};

std::string unit_list(Eigen::Index count, const std::function<DsiUnit(Eigen::Index)>& unit) {
  // Identical units are given once: the business rules ask for it.
  const std::string first = unit(0).text();
  bool same = true;
  for (Eigen::Index i = 1; i < count; ++i) same = same && unit(i).text() == first;
  return same ? first : listed(count, [&](Eigen::Index i) { return unit(i).text(); });
}

void add_covariance(XmlElement& parent, const ValueList& list, const Representation& as) {
  const Eigen::Index n = list.values.size();
  XmlElement region =
      parent.add("si:measurementUncertaintyMultivariateXMLList").add("si:ellipsoidalRegionMUXMLList");
  XmlElement matrix = region.add("si:covarianceMatrixXMLList");
  const auto unit_of = [&](Eigen::Index i) { return as.units[static_cast<std::size_t>(i)]; };
  const auto label_of = [&](Eigen::Index i) { return as.labels[static_cast<std::size_t>(i)]; };
  for (Eigen::Index column = 0; column < n; ++column) {
    XmlElement values = matrix.add("si:columnXMLList").add("si:covarianceXMLList");
    values.add("si:valueXMLList", listed(n, [&](Eigen::Index row) {
                 return dsi_number((*list.covariance)(row, column) * as.scale[row] * as.scale[column],
                                   fmt::format("covariance of {} and {}", label_of(row), label_of(column)));
               }));
    values.add("si:unitXMLList",
               unit_list(n, [&](Eigen::Index row) { return unit_of(row) * unit_of(column); }));
  }
  region.add("si:coverageFactorXMLList",
             factor_text(ellipsoid_factor(static_cast<int>(n), kCoverageProbability)));
  region.add("si:coverageProbabilityXMLList", probability_text());
  region.add("si:distributionXMLList", "normal");
}

void add_real_list(XmlElement& parent, const ValueList& list, const Representation& as) {
  const Eigen::Index n = list.values.size();
  const auto label_of = [&](Eigen::Index i) { return as.labels[static_cast<std::size_t>(i)]; };
  XmlElement real = parent.add("si:realListXMLList");
  real.add("si:labelXMLList", listed(n, label_of));
  real.add("si:valueXMLList",
           listed(n, [&](Eigen::Index i) { return dsi_number(list.values[i] * as.scale[i], label_of(i)); }));
  real.add("si:unitXMLList",
           unit_list(n, [&](Eigen::Index i) { return as.units[static_cast<std::size_t>(i)]; }));
  XmlElement expanded = real.add("si:measurementUncertaintyUnivariateXMLList").add("si:expandedMUXMLList");
  expanded.add("si:valueExpandedMUXMLList", listed(n, [&](Eigen::Index i) {
                 return dsi_number(kCoverageFactor * list.standard_uncertainty[i] * as.scale[i],
                                   "uncertainty of " + label_of(i));
               }));
  expanded.add("si:coverageFactorXMLList", factor_text(kCoverageFactor));
  expanded.add("si:coverageProbabilityXMLList", probability_text());
  expanded.add("si:distributionXMLList", "normal");
  if (list.covariance) add_covariance(real, list, as);
}

void add_real(XmlElement& parent, double value, double standard_uncertainty, const DsiUnit& unit,
              std::string_view what) {
  XmlElement real = parent.add("si:real");
  real.add("si:value", dsi_number(value, what));
  real.add("si:unit", unit.text());
  if (std::isnan(standard_uncertainty)) return;  // None was evaluated.
  XmlElement expanded = real.add("si:measurementUncertaintyUnivariate").add("si:expandedMU");
  expanded.add("si:valueExpandedMU",
               dsi_number(kCoverageFactor * standard_uncertainty, "uncertainty of " + std::string(what)));
  expanded.add("si:coverageFactor", factor_text(kCoverageFactor));
  expanded.add("si:coverageProbability", probability_text());
  expanded.add("si:distribution", "normal");
}

}  // namespace

std::string dsi_number(double value, std::string_view what) {
  if (!std::isfinite(value)) throw NumberNotFinite(fmt::format("{} is not a finite number", what));
  return fmt::format("{}", value);
}

double ellipsoid_factor(int dimensions, double probability) {
  return std::sqrt(boost::math::quantile(boost::math::chi_squared(dimensions), probability));
}

ValueList list_of(const std::vector<std::string>& labels, const std::vector<Quantity>& quantities,
                  std::optional<Eigen::MatrixXd> covariance) {
  ValueList list;
  list.labels = labels;
  const auto n = static_cast<Eigen::Index>(quantities.size());
  list.values.resize(n);
  list.standard_uncertainty.resize(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Quantity& quantity = quantities[static_cast<std::size_t>(i)];
    list.values[i] = quantity.value;
    list.standard_uncertainty[i] = quantity.standard_uncertainty;
    list.units.push_back(quantity.unit);
  }
  list.covariance = std::move(covariance);
  return list;
}

void add_value_list(XmlElement& quantity, const ValueList& list) {
  const Eigen::Index n = list.values.size();
  Representation si{list.labels, {}, Eigen::VectorXd::Ones(n)}, own{{}, {}, Eigen::VectorXd::Ones(n)};
  bool hybrid = false;
  for (Eigen::Index i = 0; i < n; ++i) {
    const UnitInDsi in = unit_in_dsi(list.units[static_cast<std::size_t>(i)]);
    si.units.push_back(in.unit);
    si.scale[i] = in.factor;
    own.units.push_back(in.own.value_or(in.unit));
    // A reader that knows only SI units finds each label once.
    own.labels.push_back(list.labels[static_cast<std::size_t>(i)] + "[" + own.units.back().text() + "]");
    hybrid = hybrid || in.own.has_value();
  }
  if (!hybrid) return add_real_list(quantity, list, si);
  XmlElement both = quantity.add("si:hybrid");
  add_real_list(both, list, si);
  add_real_list(both, list, own);
}

void add_value(XmlElement& quantity, const Quantity& value, std::string_view what) {
  const UnitInDsi in = unit_in_dsi(value.unit);
  const double scaled = value.value * in.factor, u = value.standard_uncertainty * in.factor;
  if (!in.own) return add_real(quantity, scaled, u, in.unit, what);
  XmlElement both = quantity.add("si:hybrid");
  add_real(both, scaled, u, in.unit, what);
  add_real(both, value.value, value.standard_uncertainty, *in.own, what);
}

}  // namespace abcal
