#include <fmt/format.h>

#include <map>
#include <stdexcept>

#include "app/document/band_figure.h"
#include "app/laboratory/certificate/page_numbers.h"
#include "app/laboratory/certificate/page_parts.h"
#include "app/results/analysis/report_data.h"
#include "protocol/temperature/temperature_fit.h"

namespace abcal {
namespace {

/// "g_loc*s_u" as "s_u".
std::string output_of(const std::string& symbol) {
  const std::size_t star = symbol.find('*');
  return star == std::string::npos ? symbol : symbol.substr(star + 1);
}

/// The numbers of a list as the XML has them, in its own unit where that is not of the SI.
std::vector<double> list_numbers(const PageSource& from, xmlNode* quantity) {
  const std::string at = is_hybrid(from, quantity) ? "si:hybrid/*[last()]" : "si:realListXMLList";
  std::vector<double> numbers;
  for (const std::string& word : from.xml.words(at + "/si:valueXMLList", quantity))
    numbers.push_back(number_in_xml(word));
  return numbers;
}

std::string list_unit(const PageSource& from, xmlNode* quantity) {
  const std::string at = is_hybrid(from, quantity) ? "si:hybrid/*[last()]" : "si:realListXMLList";
  const std::vector<std::string> words = from.xml.words(at + "/si:unitXMLList", quantity);
  return words.empty() ? std::string() : typeset_unit(words.front());
}

xmlNode* series_result(const PageSource& from, xmlNode* series, const std::string& ref_type) {
  const auto found = from.xml.nodes("dcc:results/dcc:result[@refType='" + ref_type + "']", series);
  return found.empty() ? nullptr : found.front();
}

xmlNode* series_quantity(const PageSource& from, xmlNode* result, const std::string& ref_type) {
  const auto found = from.xml.nodes("dcc:data/dcc:quantity[@refType='" + ref_type + "']", result);
  if (found.empty()) throw std::runtime_error("the certificate has no " + ref_type);
  return found.front();
}

/// A temperature in degrees Celsius, as the XML has it.
std::string celsius_of(const PageSource& from, xmlNode* quantity) {
  return from.text("si:hybrid/si:real[last()]/si:value", quantity);
}

/// A polynomial as the XML has it, with its covariance.
TemperaturePolynomial polynomial_in_xml(const PageSource& from, xmlNode* quantity) {
  TemperaturePolynomial polynomial;
  polynomial.name = output_of(from.content("dcc:name", quantity));
  polynomial.unit = list_unit(from, quantity);
  polynomial.coefficient = list_numbers(from, quantity);
  polynomial.order = static_cast<int>(polynomial.coefficient.size()) - 1;
  polynomial.covariance.resize(polynomial.order + 1, polynomial.order + 1);
  const std::string at = is_hybrid(from, quantity) ? "si:hybrid/*[last()]" : "si:realListXMLList";
  const auto columns = from.xml.nodes(at + "//si:columnXMLList", quantity);
  for (int j = 0; j <= polynomial.order; ++j) {
    const auto rows =
        from.xml.words("si:covarianceXMLList/si:valueXMLList", columns.at(static_cast<std::size_t>(j)));
    for (int i = 0; i <= polynomial.order; ++i)
      polynomial.covariance(i, j) = number_in_xml(rows.at(static_cast<std::size_t>(i)));
  }
  return polynomial;
}

struct CurveRange {
  double reference, low, high;
};

CurveRange curve_range(const PageSource& from, xmlNode* series) {
  xmlNode* range = series_result(from, series, "abc_temperatureSeries");
  const auto degc = [&](const char* ref_type) {
    return number_in_xml(celsius_of(from, series_quantity(from, range, ref_type)));
  };
  return {degc("abc_referenceTemperature"), degc("abc_lowestTemperature"), degc("abc_highestTemperature")};
}

/// Values of the points, and which of them are on the way down.
struct CurvePoints {
  std::vector<double> degc;
  std::vector<bool> down;
  std::vector<xmlNode*> values;  ///< One list an output.
};

CurvePoints curve_points(const PageSource& from, xmlNode* series) {
  CurvePoints points;
  xmlNode* result = series_result(from, series, "abc_temperaturePoints");
  points.degc = list_numbers(from, series_quantity(from, result, "abc_temperature"));
  points.values = from.xml.nodes("dcc:data/dcc:quantity[@refType='basic_measuredValue']", result);
  for (xmlNode* point : from.xml.nodes(
           "dcc:measurementMetaData/dcc:metaData[starts-with(@refType, 'abc_seriesPoint')]", series)) {
    const std::string leg = owned_text(xmlGetProp(point, as_xml("refType")));
    points.down.push_back(leg == "abc_seriesPointDown" || leg == "abc_seriesPointReturn");
  }
  return points;
}

BandPanel panel_of(const PageSource& from, xmlNode* quantity, const CurveRange& range,
                   const CurvePoints& points, std::size_t k) {
  constexpr int kSteps = 120;
  const TemperaturePolynomial polynomial = polynomial_in_xml(from, quantity);
  const double at_reference = polynomial.coefficient.at(0);
  BandPanel panel;
  panel.title =
      polynomial.unit.empty() ? polynomial.name : fmt::format("{} ({})", polynomial.name, polynomial.unit);
  for (int n = 0; n <= kSteps; ++n) {
    panel.x.push_back(range.low + (range.high - range.low) * n / kSteps);
    panel.y.push_back(polynomial.at(panel.x.back() - range.reference) - at_reference);
    panel.half_width.push_back(kCoverageFactor *
                               polynomial.standard_uncertainty_at(panel.x.back() - range.reference));
  }
  const std::vector<double> values = list_numbers(from, points.values.at(k));
  for (std::size_t i = 0; i < values.size(); ++i)
    (points.down.at(i) ? panel.filled : panel.open).push_back({points.degc.at(i), values[i] - at_reference});
  return panel;
}

std::vector<Figure> figures_of(const PageSource& from, xmlNode* series) {
  const CurveRange range = curve_range(from, series);
  const CurvePoints points = curve_points(from, series);
  const auto polynomials = quantities_of(from, series_result(from, series, "abc_temperaturePolynomials"));
  std::vector<Figure> figures;
  for (const auto& [title, first] :
       {std::pair{from.say("Sensitivities per local gravity: change from the value at T0."), 0U},
        {from.say("Zero-acceleration offsets: change from the value at T0."), 6U},
        {from.say("Intrinsic angles: change from the value at T0."), 3U}}) {
    std::vector<BandPanel> panels;
    for (std::size_t k = first; k < first + 3; ++k)
      panels.push_back(panel_of(from, polynomials.at(k), range, points, k));
    figures.push_back(band_figure(title + " " +
                                      from.say("Open triangles: way up, filled ones: way down; band: k = 2 "
                                               "times the standard uncertainty of the polynomial."),
                                  from.say("T (°C)"), panels));
  }
  return figures;
}

/// Slope, box and end points of every output, each with its U.
DocumentTable coefficient_table(const PageSource& from, xmlNode* series) {
  DocumentTable table;
  table.dense = true;
  table.columns = {{from.say("Quantity"), CellKind::kSymbol},
                   {from.say("Slope at T0"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {"k", CellKind::kNumber},
                   {from.say("Box"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {from.say("End points"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {from.say("Unit"), CellKind::kUnit}};
  for (xmlNode* result : from.xml.nodes(
           "dcc:results/dcc:result[starts-with(@refType, 'abc_temperatureCoefficients')]", series)) {
    table.rows.push_back({from.content("dcc:name", result)});
    std::vector<std::vector<PageValue>> forms;
    for (xmlNode* quantity : quantities_of(from, result)) forms.push_back(values_of(from, quantity, true));
    for (std::size_t i = 0; i < forms.at(0).size(); ++i) {
      const PageValue &slope = forms[0].at(i), &box = forms.at(1).at(i), &ends = forms.at(2).at(i);
      table.rows.push_back({slope.label, slope.value, slope.expanded, slope.factor, box.value, box.expanded,
                            ends.value, ends.expanded, slope.unit});
    }
  }
  return table;
}

/// Way up minus way down, and the closure.
DocumentTable difference_table(const PageSource& from, xmlNode* series) {
  DocumentTable table;
  table.dense = true;
  table.columns = {{from.say("Quantity"), CellKind::kSymbol},
                   {from.say("Difference"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {"k", CellKind::kNumber},
                   {from.say("Unit"), CellKind::kUnit},
                   {from.say("Set point (°C)"), CellKind::kNumber}};
  for (const char* ref_type : {"abc_temperatureHysteresis", "abc_temperatureClosure"}) {
    xmlNode* result = series_result(from, series, ref_type);
    if (result == nullptr) continue;
    table.rows.push_back({from.content("dcc:name", result)});
    for (xmlNode* quantity : quantities_of(from, result)) {
      const PageValue value = values_of(from, quantity, is_hybrid(from, quantity)).front();
      const auto at = from.xml.nodes("dcc:measurementMetaData/dcc:metaData/dcc:data/dcc:quantity", quantity);
      table.rows.push_back({output_of(from.content("dcc:name", quantity)), value.value, value.expanded,
                            value.factor, value.unit,
                            at.empty() ? "" : typeset_number(celsius_of(from, at.front()), from.words)});
    }
  }
  return table;
}

/// The sentences of the section: range, reference, number of points, and the meaning of T.
Paragraph range_words(const PageSource& from, xmlNode* series) {
  xmlNode* range = series_result(from, series, "abc_temperatureSeries");
  const auto degc = [&](const char* ref_type) {
    return typeset_number(celsius_of(from, series_quantity(from, range, ref_type)), from.words);
  };
  return {from.words("{points} points from {from} to {to} °C, T0 = {reference} °C.",
                     from.text("si:real/si:value", series_quantity(from, range, "abc_points")),
                     degc("abc_lowestTemperature"), degc("abc_highestTemperature"),
                     degc("abc_referenceTemperature"))
              .text +
          " " + from.content("dcc:description", range)};
}

DocumentTable polynomial_table(const PageSource& from, xmlNode* result) {
  DocumentTable table = value_table(from);
  table.may_break = true;
  table.caption = from.content("dcc:description", result);
  for (xmlNode* quantity : quantities_of(from, result)) {
    table.rows.push_back({output_of(from.content("dcc:name", quantity))});
    const std::map<std::string, std::string> degrees = degrees_of_freedom_of(from, quantity);
    for (const PageValue& value : values_of(from, quantity, is_hybrid(from, quantity))) {
      const auto nu = degrees.find("nu(" + value.label + ")");
      table.rows.push_back({value.label, value.value, value.expanded, value.factor,
                            nu == degrees.end() ? "∞" : nu->second, value.unit});
    }
  }
  return table;
}

/// The table of the runs of the points.
DocumentTable point_table(const PageSource& from, xmlNode* series) {
  DocumentTable table;
  table.may_break = true;
  table.columns = {
      {from.say("Point")}, {from.say("T (°C)"), CellKind::kNumber}, {from.say("Run file")}, {"SHA-256"}};
  const auto temperatures = values_of(
      from, series_quantity(from, series_result(from, series, "abc_temperaturePoints"), "abc_temperature"),
      true);
  std::size_t i = 0;
  for (xmlNode* point : from.xml.nodes(
           "dcc:measurementMetaData/dcc:metaData[starts-with(@refType, 'abc_seriesPoint')]", series)) {
    const std::string name = from.content("dcc:name", point);
    table.rows.push_back({name.substr(0, name.find(':')), temperatures.at(i++).value,
                          from.content("dcc:description", point), from.content("dcc:data/dcc:text", point)});
  }
  return table;
}

}  // namespace

std::vector<Section> temperature_sections(const PageSource& from, xmlNode* series) {
  Section section{from.content("dcc:name", series), {range_words(from, series)}};
  section.blocks.emplace_back(coefficient_table(from, series));
  section.blocks.emplace_back(difference_table(from, series));
  section.on_new_page = true;
  Section curves{from.say("Change over temperature"), {}};
  for (Figure& figure : figures_of(from, series)) curves.blocks.emplace_back(std::move(figure));
  return {std::move(section), std::move(curves)};
}

std::vector<Section> temperature_annex(const PageSource& from, xmlNode* series) {
  xmlNode* polynomials = series_result(from, series, "abc_temperaturePolynomials");
  xmlNode* points = series_result(from, series, "abc_temperaturePoints");
  Section coefficients{from.content("dcc:name", polynomials), {polynomial_table(from, polynomials)}};
  Section evidence{
      from.content("dcc:name", points),
      {Paragraph{from.content("dcc:description", points) + " " + from.say("The XML has their values.")}}};
  evidence.blocks.emplace_back(point_table(from, series));
  return {std::move(coefficients), std::move(evidence)};
}

}  // namespace abcal
