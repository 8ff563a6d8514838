#include "app/results/report/report_json.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "app/document/valid_text.h"
#include "app/results/analysis/held_out_words.h"
#include "app/results/analysis/result_json.h"
#include "protocol/estimators/checks/check_poses.h"
#include "protocol/record/run_operator.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

Json text(const std::string& value) {
  return value.empty() ? Json(nullptr) : Json(valid_text(value));
}

Json budget_json(const ReportData& data) {
  if (!data.budget) return nullptr;
  const Budget& budget = *data.budget;
  const auto of_outputs = [](const OutputVector& values) {
    Json json;
    for (int k = 0; k < kStudyOutputs; ++k) json[std::string(output_symbol(k))] = json_number(values(k));
    return json;
  };
  Json units;
  for (int k = 0; k < kStudyOutputs; ++k)
    units[std::string(output_symbol(k))] = output_unit(k, data.record.response_unit);
  Json lines = Json::array();
  for (const BudgetLine& line : budget.lines) {
    lines.push_back({{"input", line.input},
                     {"value", line.value},
                     {"unit", line.unit},
                     {"distribution", line.distribution},
                     {"type", line.type_a ? "A" : "B"},
                     {"key", line.key.empty() ? Json(nullptr) : Json(line.key)},
                     {"source", text(line.source)},
                     {"degrees_of_freedom", of_outputs(line.degrees_of_freedom)},
                     {"standard_uncertainty", json_number(line.standard_uncertainty)},
                     {"sensitivity", of_outputs(line.sensitivity)},
                     {"contribution", of_outputs(line.contribution)},
                     {"contribution_per_mps2", of_outputs(line.contribution_per_mps2)}});
  }
  return {{"units", units},
          {"lines", std::move(lines)},
          {"combined", of_outputs(budget.combined)},
          {"combined_per_mps2", of_outputs(budget.combined_per_mps2)},
          {"not_covered", budget.not_covered},
          {"notes", budget.notes}};
}

Json integrity_json(const std::vector<IntegrityCheck>& checks) {
  Json integrity = Json::array();
  for (const IntegrityCheck& check : checks)
    integrity.push_back({{"what", check.what}, {"good", check.good}, {"found", text(check.found)}});
  return integrity;
}

Json run_json(const StoredRun& run, const std::vector<IntegrityCheck>& checks) {
  Json instruments = Json::array();
  for (const InstrumentIdentity& i : run.header.instruments) {
    instruments.push_back({{"role", i.role},
                           {"maker", text(i.maker)},
                           {"model", text(i.model)},
                           {"serial_number", text(i.serial_number)},
                           {"firmware", text(i.firmware)},
                           {"details", text(i.details)}});
  }
  Json environment = Json::array();
  for (const StoredEnvironment& e : run.environment) {
    environment.push_back({{"moment", e.moment},
                           {"utc", e.utc},
                           {"temperature_degc", json_number(e.temperature_degc)},
                           {"humidity_percent", json_number(e.humidity_percent)},
                           {"pressure_hpa", json_number(e.pressure_hpa)}});
  }
  Json events = Json::array();
  for (const RunEvent& event : run.events)
    events.push_back({{"utc", event.utc}, {"kind", event.kind}, {"text", text(event.text)}});
  return {{"state", std::string(to_string(run.state))},
          {"angles_planned", run.header.plan.size()},
          {"angles_measured", run.measured.size()},
          {"continuations", run.record.continuations},
          {"started_utc", text(run.header.created_utc)},
          {"ended_utc", run.events.empty() ? Json(nullptr) : text(run.events.back().utc)},
          {"program_version", text(run.header.program_version)},
          {"timing",
           {{"moving_s", run.timing.moving_s},
            {"settling_s", run.timing.settling_s},
            {"dwelling_s", run.timing.dwelling_s},
            {"overhead_s", run.timing.overhead_s}}},
          {"instruments", std::move(instruments)},
          {"environment", std::move(environment)},
          {"events", std::move(events)},
          {"integrity", integrity_json(checks)},
          {"bench_toml", text(run.header.bench_toml)}};
}

/// The runs of a measurement, each with its file.
Json runs_json(const AnalysedRun& measured, int item) {
  Json list = Json::array();
  for (const RunOfMeasurement& run : measured.runs) {
    Json json{{"source", run.file}, {"sha256", run.sha256}};
    json.update(run_json(run.items.at(static_cast<std::size_t>(item) - 1), {}));
    list.push_back(std::move(json));
  }
  return list;
}

Json triple_json(const Eigen::Vector3d& values) {
  return {json_number(values(0)), json_number(values(1)), json_number(values(2))};
}

Json check_poses_json(const ReportData& data) {
  const std::optional<CheckPoseStudy> compared = compared_check_poses(data.record);
  if (!compared) return nullptr;
  const CheckPoseStudy& study = *compared;
  Json differences = Json::array();
  for (const PoseDifference& difference : study.differences) {
    differences.push_back({{"pose", difference.pose},
                           {"visit", difference.visit + 1},
                           {"after_angles", study.visits[difference.visit].after},
                           {"value", triple_json(difference.value)},
                           {"standard_uncertainty", triple_json(difference.standard_uncertainty)}});
  }
  const auto trends = [](const std::array<PoseTrend, 3>& of_outputs) {
    Json list = Json::array();
    for (const PoseTrend& trend : of_outputs) {
      list.push_back({{"value", json_number(trend.change)},
                      {"standard_uncertainty", json_number(trend.standard_uncertainty)},
                      {"smallest_found", json_number(trend.smallest_found)}});
    }
    return list;
  };
  return {{"visits", study.visits.size()},
          {"response_unit", data.record.response_unit},
          {"differences", std::move(differences)},
          {"change_of_gain", trends(study.gain)},
          {"change_of_offset", trends(study.offset)},
          {"found", study.found.size()}};
}

Json flagged_json(const RunRecord& record) {
  Json list = Json::array();
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.flags == kFlagNone) continue;
    list.push_back({{"experiment", dwell.experiment},
                    {"n", dwell.n},
                    {"closing", dwell.closing},
                    {"face", dwell.face},
                    {"alpha_deg", dwell.alpha.deg()},
                    {"flags", describe_flags(dwell.flags)}});
  }
  return list;
}

}  // namespace

nlohmann::ordered_json report_json(const ReportData& data) {
  Json json;
  json["schema"] = "abcal.report/1";
  json["created_utc"] = data.created_utc;
  json["program_version"] = data.program_version;
  json["source"] = text(data.path.string());
  json["sha256"] = data.sha256 ? Json(*data.sha256) : Json(nullptr);
  Json warnings = Json::array();
  for (const std::string& caution : cautions(data)) warnings.push_back(valid_text(caution));
  json["cautions"] = std::move(warnings);
  json["coverage_factor"] = kCoverageFactor;
  json["coverage_probability"] = kCoverageProbability;
  Json item;
  for (const IdentityPart& part : identity_of(data)) {
    item[part.key] = text(part.stated);
    item["known_by"][part.key] = to_string(part.known_by());
    item["reported"][part.key] = text(part.reported);
  }
  for (const auto& [name, key] : kItemSettings) item[key.substr(kItemLabel.size())] = text(data.label(key));
  item["mounting"] = text(data.record.expected.mounting);
  for (const auto& [name, key] : kItemMounting) item[key.substr(kItemLabel.size())] = text(data.label(key));
  json["item"] = std::move(item);
  json["bench"] = text(data.label("bench.name"));
  json["operator"] = text(data.label("operator.name"));
  if (data.run) {
    const std::vector<RunOperator> operators = operators_of(*data.run);
    json["operator_verified"] =
        !operators.empty() && std::all_of(operators.begin(), operators.end(),
                                          [](const RunOperator& who) { return who.verified(); });
  }
  json["run"] = data.run && !data.is_of_several_runs() ? run_json(*data.run, data.integrity) : Json(nullptr);
  if (data.is_of_several_runs()) {
    json["runs"] = runs_json(*data.all, data.item);
    json["integrity"] = integrity_json(data.integrity);
  }
  Json results = Json::array();
  for (const CalibrationResult& result : data.results) results.push_back(result_json(result));
  json["results"] = std::move(results);
  const Tolerances& t = data.record.tolerances;
  json["tolerances"] = {{"alignment_deg", t.alignment.deg()},
                        {"step_deg", t.step.deg()},
                        {"initial_turn_deg", t.initial_turn.deg()},
                        {"zero_deg", t.zero.deg()},
                        {"drift", t.drift}};
  json["budget"] = budget_json(data);
  json["held_out_norm"] = data.held_out_norm ? held_out_json(*data.held_out_norm) : Json(nullptr);
  if (data.is_of_several_runs()) return json;  // The rest is of one run.
  json["check_poses"] = check_poses_json(data);
  json["flagged_angles"] = flagged_json(data.record);
  return json;
}

}  // namespace abcal
