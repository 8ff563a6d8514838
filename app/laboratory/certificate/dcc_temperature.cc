#include "app/laboratory/certificate/dcc_temperature.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "app/laboratory/certificate/dcc_conditions.h"
#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/scope.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr double kZeroCelsiusKelvin = 273.15;
constexpr std::size_t kSeriesOutputs = 9, kInGroup = 3;

/// The series, and the words and the scope with which it is certified.
struct SeriesSource {
  const Certificate& certificate;
  const Words& words;
  const TemperatureResult& result;
  const CalibrationResult& at_reference;  ///< Result of the certificate's run: for the scope and local
                                          ///< gravity.
};

/// Outputs of one unit.
struct CoefficientGroup {
  std::string ref_type;
  Wording name;
  std::size_t first = 0;
};

std::array<CoefficientGroup, 3> coefficient_groups(const Words& words) {
  return {
      {{"OfSensitivity", words("Temperature coefficients of the sensitivities, relative"), 0},
       {"OfAngle", words("Temperature coefficients of the intrinsic angles"), 3},
       {"OfOffset",
        words("Temperature coefficients of the offsets, in units of standard gravity g = 9.80665 m/s2"), 6}}};
}

/// Symbol of an output as in the other results: sensitivities are per local gravity.
std::string output_symbol_of(std::size_t k, const std::string& name) {
  return k < kInGroup ? "g_loc*" + name : name;
}

Quantity quantity_of(double value, double standard_uncertainty, const std::string& unit) {
  Quantity quantity;
  quantity.value = value;
  quantity.standard_uncertainty = standard_uncertainty;
  quantity.unit = unit;
  return quantity;
}

/// Whether results are marked as within or outside a scope.
bool has_marks(const SeriesSource& from) {
  return !from.certificate.run.stated.marks.empty();
}

/// Raises the uncertainty of an output to the smallest of the scope.
ScopeMark raise(const SeriesSource& from, std::size_t k, Quantity& quantity) {
  if (!has_marks(from)) return ScopeMark::kNone;
  const std::string& name = from.result.polynomials[k].name;
  const char* group = k < kInGroup       ? "intrinsic_sensitivity"
                      : k < 2 * kInGroup ? "intrinsic_angle"
                                         : "offset";
  const auto cmc = smallest_uncertainty(from.certificate.laboratory.scope, from.at_reference,
                                        group + name.substr(name.rfind('_')), quantity);
  if (!cmc) return ScopeMark::kOutside;
  const double least = *cmc / coverage_factor(quantity);
  if (!(least > quantity.standard_uncertainty)) return ScopeMark::kWithin;
  quantity.standard_uncertainty = least;
  return ScopeMark::kRaised;
}

/// A list of changes with temperature, which no scope covers.
ValueList unscoped(const SeriesSource& from, ValueList list) {
  if (has_marks(from)) list.marks.assign(list.labels.size(), ScopeMark::kOutside);
  return list;
}

/// In kelvin and in degrees Celsius.
void add_temperature(XmlElement& quantity, const std::vector<double>& degc,
                     const std::vector<std::string>& labels) {
  std::vector<std::string> kelvin, celsius, own;
  for (std::size_t i = 0; i < degc.size(); ++i) {
    // To a thousandth: more than sensors of temperature have.
    const double rounded = std::round(degc[i] * 1e3) / 1e3;
    kelvin.push_back(dsi_number(rounded + kZeroCelsiusKelvin, "temperature"));
    celsius.push_back(dsi_number(rounded, "temperature"));
    if (!labels.empty()) own.push_back(labels[i] + "[\\degreecelsius]");
  }
  XmlElement both = quantity.add("si:hybrid");
  if (!labels.empty()) {
    add_number_list(both, labels, kelvin, "\\kelvin");
    add_number_list(both, own, celsius, "\\degreecelsius");
    return;
  }
  for (const auto& [value, unit] :
       {std::pair{kelvin.front(), "\\kelvin"}, std::pair{celsius.front(), "\\degreecelsius"}}) {
    XmlElement real = both.add("si:real");
    real.add("si:value", value);
    real.add("si:unit", unit);
  }
}

void add_temperature_range(XmlElement& results, const SeriesSource& from) {
  const Words& words = from.words;
  const TemperatureResult& result = from.result;
  XmlElement data = add_result(
      results, "abc_temperatureSeries", words("Series over temperature"),
      result.by_item()
          ? words("Temperature T is that of the item's own sensor, mean over each run. The sensor is not "
                  "calibrated here, and its errors are in no uncertainty: kelvins are those that it shows. "
                  "What is stated over temperature holds between the lowest and the highest T.")
          : words("Temperature T is the set point of the chamber, as the item has no sensor. Its difference "
                  "from the temperature of the item is not known and in no uncertainty. What is stated over "
                  "temperature holds between the lowest and the highest T."));
  const auto add = [&](const char* ref_type, const Wording& name, double degc) {
    XmlElement quantity = add_quantity(data, ref_type, name);
    add_temperature(quantity, {degc}, {});
  };
  add("abc_referenceTemperature", words("Reference temperature T0"), result.reference_degc);
  add("abc_lowestTemperature", words("Lowest temperature"), result.least_degc);
  add("abc_highestTemperature", words("Highest temperature"), result.most_degc);
  add_number(data, "abc_points", words("Number of points"), fmt::format("{}", result.points.size()), "1");
}

void add_points(XmlElement& results, const SeriesSource& from) {
  const Words& words = from.words;
  std::vector<std::string> labels;
  std::vector<double> degc;
  for (const TemperaturePoint& point : from.result.points) {
    labels.push_back(fmt::format("P{}", point.number));
    degc.push_back(point.temperature_degc);
  }
  XmlElement data =
      add_result(results, "abc_temperaturePoints", words("Results at each point of the series"),
                 words("Each point is a calibration of its own; what they have in common of the stage is in "
                       "the uncertainty of each. Sensitivities are per local gravity."));
  XmlElement temperature =
      add_quantity(data, "abc_temperature",
                   from.result.by_item() ? words("Temperature of the item, by its own sensor")
                                         : words("Temperature, as the chamber was set"));
  add_temperature(temperature, degc, labels);
  for (std::size_t k = 0; k < kSeriesOutputs; ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    const std::string& unit = from.result.polynomials[k].unit;
    std::vector<Quantity> values;
    std::vector<ScopeMark> marks;
    for (const TemperaturePoint& point : from.result.points) {
      values.push_back(quantity_of(point.value[i], std::sqrt(point.own(i, i) + point.shared(i, i)), unit));
      marks.push_back(raise(from, k, values.back()));
    }
    ValueList list = list_of(labels, values);
    if (has_marks(from)) list.marks = std::move(marks);
    add_list(data, words, {output_symbol_of(k, from.result.polynomials[k].name), {}}, list);
  }
}

/// A coefficient with the unit of the certificate. In the series those of offsets are in millionths of local
/// gravity; the certificate's unit is that of standard gravity, and the uncertainty of local gravity belongs
/// to it.
Quantity certified_coefficient(const SeriesSource& from, std::size_t k, double value,
                               double standard_uncertainty, double degrees_of_freedom) {
  Quantity quantity = quantity_of(value, standard_uncertainty, from.result.coefficients[k].unit);
  quantity.degrees_of_freedom = degrees_of_freedom;
  if (k < 2 * kInGroup) return quantity;
  const Quantity& g_loc = from.at_reference.g_loc;
  const double of_gravity = quantity.value * g_loc.standard_uncertainty / g_loc.value;
  quantity.value *= g_loc.value / kStandardGravity;
  quantity.standard_uncertainty =
      std::hypot(standard_uncertainty, std::isnan(of_gravity) ? 0.0 : of_gravity) * g_loc.value /
      kStandardGravity;
  return quantity;
}

void add_coefficients(XmlElement& results, const SeriesSource& from, const CoefficientGroup& group) {
  const Words& words = from.words;
  XmlElement data = add_result(results, "abc_temperatureCoefficients" + group.ref_type, group.name);
  std::vector<std::string> labels;
  std::vector<Quantity> slope, box, ends;
  for (std::size_t k = group.first; k < group.first + kInGroup; ++k) {
    const TemperatureCoefficient& one = from.result.coefficients[k];
    labels.push_back("TC_" + one.name);
    slope.push_back(
        certified_coefficient(from, k, one.at_reference, one.standard_uncertainty, one.degrees_of_freedom));
    box.push_back(certified_coefficient(from, k, one.box, one.box_uncertainty, one.box_degrees_of_freedom));
    ends.push_back(certified_coefficient(from, k, one.end_point, one.end_point_uncertainty,
                                         one.end_point_degrees_of_freedom));
  }
  add_list(data, words, words("Slope at T0"), unscoped(from, list_of(labels, slope)));
  add_list(data, words, words("Box: largest minus smallest over the range, divided by it"),
           unscoped(from, list_of(labels, box)));
  add_list(data, words, words("End points: change over the range, divided by it"),
           unscoped(from, list_of(labels, ends)));
}

void add_polynomials(XmlElement& results, const SeriesSource& from) {
  const Words& words = from.words;
  XmlElement data =
      add_result(results, "abc_temperaturePolynomials", words("Polynomials over temperature"),
                 words("Value at T = a_0 + a_1 x + a_2 x^2 and so on, x = (T - T0)/K; its standard "
                       "uncertainty is that of this sum with the covariance of the coefficients. They have "
                       "all digits, since they belong together. Sensitivities are per local gravity."));
  for (std::size_t k = 0; k < kSeriesOutputs; ++k) {
    const TemperaturePolynomial& polynomial = from.result.polynomials[k];
    std::vector<std::string> labels;
    std::vector<Quantity> values;
    for (int n = 0; n <= polynomial.order; ++n) {
      labels.push_back(fmt::format("a_{}", n));
      values.push_back(quantity_of(polynomial.coefficient[static_cast<std::size_t>(n)],
                                   std::sqrt(polynomial.covariance(n, n)), polynomial.unit));
      values.back().degrees_of_freedom =
          polynomial.degrees_of_freedom_of(Eigen::VectorXd::Unit(polynomial.order + 1, n));
    }
    // Raised all together, so that no value from the sum is below the scope and the correlations stay.
    const double u = values.front().standard_uncertainty;
    const ScopeMark mark = raise(from, k, values.front());
    const double factor =
        mark == ScopeMark::kRaised && u > 0.0 ? values.front().standard_uncertainty / u : 1.0;
    for (std::size_t n = 1; n < values.size(); ++n) values[n].standard_uncertainty *= factor;
    ValueList list = unscoped(from, list_of(labels, values, factor * factor * polynomial.covariance));
    list.all_digits = true;
    if (has_marks(from)) list.marks.front() = mark;
    add_list(data, words, {output_symbol_of(k, polynomial.name), {}}, list);
  }
}

/// Differences between the ways up and down, and between the end and the beginning.
void add_differences(XmlElement& results, const SeriesSource& from) {
  const Words& words = from.words;
  const std::vector<TemperatureHysteresis>& all = from.result.hysteresis;
  if (all.front().has_both_ways) {
    XmlElement data =
        add_result(results, "abc_temperatureHysteresis", words("Way up minus way down, where it is largest"),
                   words("Corrected to equal temperature of the item by the polynomials. What all points "
                         "have in common of the stage is not in its uncertainty."));
    for (std::size_t k = 0; k < kSeriesOutputs; ++k) {
      const TemperatureHysteresis& one = all[k];
      XmlElement quantity = add_quantity(data, "abc_upMinusDown", {output_symbol_of(k, one.name), {}});
      add_value(quantity, quantity_of(one.largest, one.standard_uncertainty, one.unit), one.name);
      XmlElement metadata = quantity.add("dcc:measurementMetaData");
      if (has_marks(from)) add_scope_marks(metadata, words, {one.name}, {ScopeMark::kOutside});
      const Wording name = words("Set point");
      XmlElement at = add_metadatum(metadata, "abc_setPoint", name);
      XmlElement facts = at.add("dcc:data");
      XmlElement set_point = add_quantity(facts, "abc_setPoint", name);
      add_temperature(set_point, {one.at_degc}, {});
    }
  }
  if (!all.front().has_closure) return;
  XmlElement data = add_result(results, "abc_temperatureClosure",
                               words("Closure: last point minus first point, both at the reference"),
                               words("Corrected to equal temperature of the item by the polynomials. What "
                                     "all points have in common of the stage is not in its uncertainty."));
  for (std::size_t k = 0; k < kSeriesOutputs; ++k) {
    XmlElement quantity = add_quantity(data, "abc_closure", {output_symbol_of(k, all[k].name), {}});
    add_value(quantity, quantity_of(all[k].closure, all[k].closure_uncertainty, all[k].unit), all[k].name);
    if (!has_marks(from)) continue;
    XmlElement metadata = quantity.add("dcc:measurementMetaData");
    add_scope_marks(metadata, words, {all[k].name}, {ScopeMark::kOutside});
  }
}

void add_polynomial_method(XmlElement& methods, const SeriesSource& from) {
  XmlElement method = methods.add("dcc:usedMethod");
  method.attribute("refType", "abc_temperatureSeries");
  add_words(method, "dcc:name", from.words("Polynomials over temperature"));
  add_words(method, "dcc:description",
            from.words("Each point is analysed by itself. What is the same at every point (alignment, wobble "
                       "and angles of the stage) shifts all points together: it is in the uncertainty of the "
                       "values at T0 and hardly in that of the change with temperature. Generalised least "
                       "squares; the order of each polynomial by likelihood ratios at 95 %. Scatter of the "
                       "points that their own noise does not explain is in the uncertainties."));
}

/// "abc_seriesPointUp", and the leg in words.
std::pair<std::string, Wording> leg_of(const Words& words, SeriesLeg leg) {
  switch (leg) {
    case SeriesLeg::kReference:
      return {"abc_seriesPointReference", words("reference")};
    case SeriesLeg::kUp:
      return {"abc_seriesPointUp", words("way up")};
    case SeriesLeg::kDown:
      return {"abc_seriesPointDown", words("way down")};
    case SeriesLeg::kReturn:
      return {"abc_seriesPointReturn", words("return to the reference")};
  }
  return {"abc_seriesPoint", words("reference")};
}

/// The runs of the points, and the times when they were measured.
void add_evidence(XmlElement& measurement, const SeriesSource& from) {
  const Words& words = from.words;
  XmlElement list = measurement.add("dcc:measurementMetaData");
  std::vector<const ReportData*> runs;
  const std::vector<ReportData>& points = from.certificate.series->points;
  for (std::size_t i = 0; i < points.size(); ++i) {
    runs.push_back(&points[i]);
    const TemperaturePoint& point = from.result.points[i];
    const auto& [ref_type, leg] = leg_of(words, point.leg);
    XmlElement metadatum = add_metadatum(
        list, ref_type,
        words("Point {point}, {angle}: run file, and SHA-256 of its raw data", point.number, leg.text));
    add_words(metadatum, "dcc:description", words.as_given(points[i].path.filename().string()));
    add_text(metadatum,
             points[i].sha256 ? words.as_given(*points[i].sha256) : words("none: the run is not closed"));
  }
  const auto [begin, end] = period_of(runs);
  XmlElement period = add_metadatum(list, "abc_period", words("Measured, UTC"));
  add_text(period, words("{from} to {to}", begin, end));
}

}  // namespace

void add_temperature_series(XmlElement& measurements, const Certificate& certificate) {
  const CertifiedSeries& series = *certificate.series;
  const SeriesSource from{certificate, certificate.words, *series.result, certificate.run.data.result()};
  const Words& words = from.words;
  XmlElement measurement = measurements.add("dcc:measurementResult");
  measurement.attribute("refType", "abc_temperatureSeries");
  std::string name = words("Calibration over temperature").text;
  if (certificate.draft()) name = words("DRAFT").text + ": " + name;
  add_words(measurement, "dcc:name", words.as_given(name));
  const ReportData& first = series.points.front();
  XmlElement methods = add_methods(measurement, certificate, first);
  add_polynomial_method(methods, from);
  add_used_software(measurement, certificate, first);
  add_equipment(measurement, certificate, first);
  std::vector<const ReportData*> runs;
  for (const ReportData& point : series.points) runs.push_back(&point);
  add_conditions(measurement, certificate, runs, {});
  XmlElement results = measurement.add("dcc:results");
  add_temperature_range(results, from);
  for (const CoefficientGroup& group : coefficient_groups(words)) add_coefficients(results, from, group);
  add_differences(results, from);
  add_polynomials(results, from);
  add_points(results, from);
  add_evidence(measurement, from);
}

}  // namespace abcal
