#include "app/results/report/campaign_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "app/results/analysis/estimators.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_text.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

Quantity mean_of(const CampaignProperty& property) {
  Quantity quantity;
  quantity.value = property.spread.mean;
  quantity.standard_uncertainty = property.standard_uncertainty;
  return quantity;
}

std::string digits(double value) {
  return fmt::format("{:.2e}", value);
}

}  // namespace

const CalibrationResult& CampaignReport::Run::result() const {
  return result_of(results, estimator);
}

bool CampaignReport::usable() const {
  return std::all_of(runs.begin(), runs.end(),
                     [](const Run& run) { return run.result().verdict != Verdict::kNotUsable; });
}

std::vector<CampaignSummary> CampaignReport::summaries() const {
  std::vector<CampaignSummary> summaries;
  for (std::size_t e = 0; e < runs.front().results.size(); ++e) {
    std::vector<CalibrationResult> of_one;
    for (const Run& run : runs) of_one.push_back(run.results[e]);
    summaries.push_back(summarise_campaign(of_one));
    summaries.back().estimator = runs.front().results[e].estimator;
  }
  return summaries;
}

namespace {

std::string text_of(const CampaignReport& report, std::FILE* stream) {
  std::string text = emphasised(stream, Emphasis::kHeading, report.title) + "\n";
  for (std::size_t k = 0; k < report.runs.size(); ++k) {
    const CampaignReport::Run& run = report.runs[k];
    const CalibrationResult& result = run.result();
    text += fmt::format("  {:>3}  {}: {} ({})\n", k + 1, run.path.string(), to_string(result.verdict),
                        result.why);
  }
  for (const CampaignSummary& summary : report.summaries()) {
    text += "\n" +
            emphasised(stream, Emphasis::kHeading, "Mean of the runs, estimator " + summary.estimator) + "\n";
    if (summary.properties.empty()) {
      text += "  none: " + summary.why + "\n";
      continue;
    }
    text +=
        fmt::format("  {:<7} {:>28} {:>6} {:>10} {:>10} {:>10} {:>10} {:>10}  {}\n", "", "mean +- std. unc.",
                    "k(95%)", "std. dev.", "within", "between", "type A", "type B", "unit");
    for (const CampaignProperty& p : summary.properties) {
      text += fmt::format("  {:<7} {:>28} {:>6.2f} {:>10} {:>10} {:>10} {:>10} {:>10}  {}\n", p.name,
                          value_with_uncertainty(mean_of(p)), p.coverage_factor,
                          digits(p.spread.standard_deviation), digits(p.spread.within),
                          digits(p.spread.between), digits(p.type_a), digits(p.type_b), p.unit);
    }
  }
  return text;
}

}  // namespace

std::string campaign_text(std::span<const CampaignReport> items, std::FILE* stream) {
  std::string text;
  for (const CampaignReport& report : items) text += (text.empty() ? "" : "\n") + text_of(report, stream);
  text +=
      "\n  std. dev.: between the runs; within: repeatability, pooled over the runs; between: what "
      "repeatability does not explain\n  type A of the mean has one degree of freedom less than there are "
      "runs; type B does not average out: one stage\n";
  return text;
}

namespace {

Json json_of(const CampaignReport& report) {
  Json runs = Json::array();
  for (const CampaignReport::Run& run : report.runs) {
    const CalibrationResult& result = run.result();
    runs.push_back(
        {{"file", run.path.string()}, {"verdict", to_string(result.verdict)}, {"why", result.why}});
  }
  Json estimators = Json::array();
  for (const CampaignSummary& summary : report.summaries()) {
    Json properties = Json::object();
    for (const CampaignProperty& p : summary.properties) {
      properties[p.name] = {{"mean", p.spread.mean},
                            {"standard_uncertainty", p.standard_uncertainty},
                            {"type_a", p.type_a},
                            {"type_b", p.type_b},
                            {"degrees_of_freedom", p.degrees_of_freedom},
                            {"coverage_factor", p.coverage_factor},
                            {"expanded_uncertainty", p.expanded_uncertainty()},
                            {"standard_deviation", p.spread.standard_deviation},
                            {"within_runs", p.spread.within},
                            {"between_runs", p.spread.between},
                            {"chi2", p.spread.chi2},
                            {"chi2_probability", p.spread.chi2_probability},
                            {"unit", p.unit}};
    }
    estimators.push_back(
        {{"estimator", summary.estimator}, {"why", summary.why}, {"properties", std::move(properties)}});
  }
  return {{"schema", "abcal.campaign/1"}, {"runs", std::move(runs)}, {"estimators", std::move(estimators)}};
}

}  // namespace

Json campaign_json(std::span<const CampaignReport> items) {
  std::vector<Json> objects;
  for (const CampaignReport& report : items) objects.push_back(json_of(report));
  return json_of_items(std::move(objects));
}

}  // namespace abcal
