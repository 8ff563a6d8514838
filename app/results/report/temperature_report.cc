#include "app/results/report/temperature_report.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "app/document/band_figure.h"
#include "app/system/version.h"
#include "protocol/quantities/output_names.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kCoverage = 2.0;

std::string number(double value) {
  return fmt::format("{:.7g}", value);
}
std::string two_digits(double value) {
  return fmt::format("{:.1e}", value);
}

DocumentTable points_table(const TemperatureReport& report) {
  DocumentTable table{"Points",
                      {{"no."},
                       {"leg"},
                       {"set (degC)", CellKind::kNumber},
                       {"T (degC)", CellKind::kNumber},
                       {"change (K)", CellKind::kNumber},
                       {"verdict"},
                       {"run file"}},
                      {}};
  for (std::size_t n = 0; n < report.result.points.size(); ++n) {
    const TemperaturePoint& point = report.result.points[n];
    table.rows.push_back({std::to_string(point.number), std::string(to_string(point.leg)),
                          fmt::format("{:g}", point.set_degc), fmt::format("{:.2f}", point.temperature_degc),
                          fmt::format("{:+.3f}", point.change_k), std::string(to_string(point.verdict)),
                          n < report.files.size() ? report.files[n].filename().string() : std::string()});
  }
  return table;
}

DocumentTable coefficients_table(const TemperatureResult& result) {
  DocumentTable table{
      fmt::format("Temperature coefficients, {:.1f} to {:.1f} degC", result.least_degc, result.most_degc),
      {{"", CellKind::kSymbol},
       {fmt::format("slope at {:g} degC", result.reference_degc), CellKind::kNumber},
       {"u", CellKind::kNumber},
       {"box", CellKind::kNumber},
       {"end point", CellKind::kNumber},
       {"unit", CellKind::kUnit}},
      {}};
  for (const TemperatureCoefficient& each : result.coefficients)
    table.rows.push_back({each.name, fmt::format("{:.4g}", each.at_reference),
                          two_digits(each.standard_uncertainty), fmt::format("{:.4g}", each.box),
                          fmt::format("{:.4g}", each.end_point), each.unit});
  return table;
}

DocumentTable polynomials_table(const TemperatureResult& result) {
  DocumentTable table{fmt::format("Polynomials over T - {:g} degC, T {}", result.reference_degc,
                                  result.by_item() ? "of the item's own sensor"
                                                   : "as the chamber was set (the item has no sensor)"),
                      {{"", CellKind::kSymbol},
                       {"n", CellKind::kNumber},
                       {"coefficient of (T - T0)^n", CellKind::kNumber},
                       {"u", CellKind::kNumber},
                       {"unit", CellKind::kUnit}},
                      {}};
  for (const TemperaturePolynomial& each : result.polynomials) {
    for (int n = 0; n <= each.order; ++n) {
      const auto i = static_cast<std::size_t>(n);
      table.rows.push_back({n == 0 ? each.name : "", std::to_string(n), number(each.coefficient[i]),
                            two_digits(std::sqrt(each.covariance(n, n))),
                            n == 0 ? each.unit : fmt::format("{}/K^{}", each.unit, n)});
    }
  }
  table.may_break = true;
  return table;
}

DocumentTable quality_table(const TemperatureResult& result) {
  DocumentTable table{"Residuals, hysteresis and closure",
                      {{"", CellKind::kSymbol},
                       {"order", CellKind::kNumber},
                       {"residual rms", CellKind::kNumber},
                       {"largest", CellKind::kNumber},
                       {"excess", CellKind::kNumber},
                       {"up - down", CellKind::kNumber},
                       {"at (degC)", CellKind::kNumber},
                       {"u", CellKind::kNumber},
                       {"closure", CellKind::kNumber},
                       {"u", CellKind::kNumber},
                       {"unit", CellKind::kUnit}},
                      {}};
  for (std::size_t k = 0; k < result.polynomials.size(); ++k) {
    const TemperaturePolynomial& p = result.polynomials[k];
    const TemperatureHysteresis& h = result.hysteresis[k];
    const auto if_known = [](bool known, const std::string& text) { return known ? text : std::string("-"); };
    table.rows.push_back({p.name, std::to_string(p.order), two_digits(p.residual_rms),
                          two_digits(p.residual_max), two_digits(p.excess),
                          if_known(h.has_both_ways, two_digits(h.largest)),
                          if_known(h.has_both_ways, fmt::format("{:g}", h.at_degc)),
                          if_known(h.has_both_ways, two_digits(h.standard_uncertainty)),
                          if_known(h.has_closure, two_digits(h.closure)),
                          if_known(h.has_closure, two_digits(h.closure_uncertainty)), p.unit});
  }
  table.dense = true;
  return table;
}

DocumentTable stage_table(const TemperatureResult& result) {
  DocumentTable table{"The stage over temperature, as each run found it",
                      {{"", CellKind::kSymbol},
                       {"slope", CellKind::kNumber},
                       {"u", CellKind::kNumber},
                       {"unit", CellKind::kUnit},
                       {"probability", CellKind::kNumber},
                       {""}},
                      {}};
  for (const StageTrend& each : result.stage)
    table.rows.push_back({each.name, two_digits(each.slope), two_digits(each.standard_uncertainty),
                          each.unit + "/K", fmt::format("{:.2g}", each.probability),
                          each.constant() ? "no change found" : "CHANGES"});
  return table;
}

/// Three outputs of a group: the points, the curves and the bands.
Figure figure_of(const TemperatureResult& result, std::size_t group, const std::string& title) {
  constexpr int kSteps = 120;
  std::vector<BandPanel> panels;
  for (std::size_t k = 3 * group; k < 3 * group + 3; ++k) {
    const TemperaturePolynomial& p = result.polynomials[k];
    const double at_reference = p.coefficient.at(0);
    BandPanel& panel = panels.emplace_back();
    panel.title = fmt::format("{} - {:.6g} {}", p.name, at_reference, p.unit);
    for (int n = 0; n <= kSteps; ++n) {
      panel.x.push_back(result.least_degc + (result.most_degc - result.least_degc) * n / kSteps);
      const double d = panel.x.back() - result.reference_degc;
      panel.y.push_back(p.at(d) - at_reference);
      panel.half_width.push_back(kCoverage * p.standard_uncertainty_at(d));
    }
    for (const TemperaturePoint& point : result.points) {
      const bool down = point.leg == SeriesLeg::kDown || point.leg == SeriesLeg::kReturn;
      (down ? panel.filled : panel.open)
          .push_back({point.temperature_degc, point.value[static_cast<Eigen::Index>(k)] - at_reference});
    }
  }
  return band_figure(title +
                         ": change from the value at the reference. Open triangles: way up, filled ones: way "
                         "down; band: k = 2 times the standard uncertainty of the polynomial.",
                     "T (degC)", panels);
}

std::string shared_words() {
  return "Each point is analysed by itself. What is the same at every point (alignment, wobble and angles of "
         "the stage, type B) shifts all points together: it is in the uncertainty of the values at the "
         "reference, and hardly in that of their change with temperature. The order of each polynomial "
         "follows from likelihood ratios at 95 %. \"Excess\" is the scatter of the points about the "
         "polynomial that their own noise does not explain, e.g. hysteresis; it is in the uncertainties.";
}

Json json_of(const TemperaturePolynomial& p) {
  Json covariance = Json::array();
  for (Eigen::Index i = 0; i < p.covariance.rows(); ++i) {
    std::vector<double> row;
    for (Eigen::Index j = 0; j < p.covariance.cols(); ++j) row.push_back(p.covariance(i, j));
    covariance.push_back(row);
  }
  return {{"name", p.name},
          {"unit", p.unit},
          {"order", p.order},
          {"coefficients", p.coefficient},
          {"covariance", covariance},
          {"likelihood_ratios", p.likelihood_ratio},
          {"residuals", p.residual},
          {"residual_rms", p.residual_rms},
          {"residual_max", p.residual_max},
          {"excess", p.excess},
          {"chi2", p.chi2},
          {"degrees_of_freedom", p.degrees_of_freedom}};
}

Json json_of(const TemperaturePoint& point, const std::string& file) {
  std::vector<double> values, own, shared;
  for (Eigen::Index k = 0; k < 9; ++k) {
    values.push_back(point.value[k]);
    own.push_back(std::sqrt(point.own(k, k)));
    shared.push_back(std::sqrt(std::max(0.0, point.shared(k, k))));
  }
  return {{"number", point.number},
          {"leg", to_string(point.leg)},
          {"set_degc", point.set_degc},
          {"temperature_degc", point.temperature_degc},
          {"change_k", point.change_k},
          {"verdict", to_string(point.verdict)},
          {"file", file},
          {"values", values},
          {"own_standard_uncertainty", own},
          {"shared_standard_uncertainty", shared}};
}

}  // namespace

Document temperature_document(const TemperatureReport& report) {
  Document document;
  document.title = "Calibration over temperature";
  document.subtitle = report.item.empty() ? std::string("accelerometer") : report.item;
  document.identification = document.subtitle;
  document.origin = std::string("abcal ") + program_version();
  for (const std::string& reason : report.result.reasons())
    document.cautions.push_back("This series is doubtful: " + reason + ".");
  document.sections.push_back({"Points", {points_table(report)}});
  document.sections.push_back(
      {"Over temperature",
       {coefficients_table(report.result), Paragraph{shared_words()},
        figure_of(report.result, 0, "Sensitivities"), figure_of(report.result, 2, "Offsets"),
        figure_of(report.result, 1, "Angles between the axes"), quality_table(report.result),
        polynomials_table(report.result)}});
  if (!report.result.stage.empty()) document.sections.back().blocks.emplace_back(stage_table(report.result));
  return document;
}

Json temperature_json(const TemperatureReport& report) {
  const TemperatureResult& result = report.result;
  Json json{{"schema", "abcal.temperature/1"},
            {"item", report.item},
            {"response_unit", report.unit},
            {"reference_degc", result.reference_degc},
            {"temperature_by", result.by_item() ? "item" : "set_point"},
            {"least_degc", result.least_degc},
            {"most_degc", result.most_degc},
            {"verdict", report.result.usable() ? "usable" : "doubtful"},
            {"outputs", kIntrinsicSymbols},
            {"points", Json::array()},
            {"polynomials", Json::array()},
            {"coefficients", Json::array()},
            {"hysteresis", Json::array()},
            {"stage", Json::array()}};
  if (!result.usable()) json["why"] = result.reasons();
  for (std::size_t n = 0; n < result.points.size(); ++n)
    json["points"].push_back(json_of(
        result.points[n], n < report.files.size() ? report.files[n].filename().string() : std::string()));
  for (const TemperaturePolynomial& each : result.polynomials) json["polynomials"].push_back(json_of(each));
  for (const TemperatureCoefficient& each : result.coefficients)
    json["coefficients"].push_back({{"name", each.name},
                                    {"unit", each.unit},
                                    {"at_reference", each.at_reference},
                                    {"standard_uncertainty", each.standard_uncertainty},
                                    {"box", each.box},
                                    {"box_standard_uncertainty", each.box_uncertainty},
                                    {"end_point", each.end_point},
                                    {"end_point_standard_uncertainty", each.end_point_uncertainty}});
  for (const TemperatureHysteresis& each : result.hysteresis) {
    Json entry{{"name", each.name}, {"unit", each.unit}};
    if (each.has_both_ways) {
      entry["up_minus_down"] = each.largest;
      entry["standard_uncertainty"] = each.standard_uncertainty;
      entry["at_degc"] = each.at_degc;
    }
    if (each.has_closure) {
      entry["closure"] = each.closure;
      entry["closure_standard_uncertainty"] = each.closure_uncertainty;
    }
    json["hysteresis"].push_back(entry);
  }
  for (const StageTrend& each : result.stage)
    json["stage"].push_back({{"name", each.name},
                             {"unit", each.unit + "/K"},
                             {"slope", each.slope},
                             {"standard_uncertainty", each.standard_uncertainty},
                             {"probability", each.probability},
                             {"constant", each.constant()}});
  return json;
}

}  // namespace abcal
