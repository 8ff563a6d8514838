#include "app/commands/apply/apply_text.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <set>
#include <utility>
#include <vector>

#include "drivers/text/letters.h"
#include "drivers/text/names.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr auto kShapeNames = names<CorrectionShape>({{CorrectionShape::kOffset, "offset"},
                                                     {CorrectionShape::kDiagonal, "diagonal"},
                                                     {CorrectionShape::kFull, "full"}});

constexpr auto kShapeWords = names<CorrectionShape>(
    {{CorrectionShape::kOffset, "offsets only: scales and angles between the axes stay as they are"},
     {CorrectionShape::kDiagonal, "offsets and scales: angles between the axes stay as they are"}});

std::string content(const RegisterTexts& registers, const std::string& name) {
  const auto found = registers.find(name);
  return found == registers.end() ? "-" : found->second;
}

/// Errors side by side: as found, as predicted, as left.
using Columns = std::vector<std::pair<std::string, const ResponseErrors*>>;

Columns columns_of(const ApplyReport& report) {
  Columns columns{{"as found", &report.as_found}, {"predicted", &report.predicted}};
  if (report.as_left) columns.emplace_back("as left", &*report.as_left);
  return columns;
}

std::string error_table(const ApplyReport& report) {
  const Columns columns = columns_of(report);
  std::string text = fmt::format("  {:<30}", "errors of the output");
  for (const auto& [name, errors] : columns) text += fmt::format("{:>24}", name);
  text += "\n";
  const auto row = [&](const std::string& name, const auto& value, const auto& u) {
    text += fmt::format("  {:<30}", name);
    for (const auto& [title, errors] : columns) {
      std::string cell = fmt::format("{:+.3g}", value(*errors));
      if (title != "predicted") cell += fmt::format(" (u {:.1g})", u(*errors));
      text += fmt::format("{:>24}", cell);
    }
    text += "\n";
  };
  for (Eigen::Index j = 0; j < 3; ++j)
    row(
        fmt::format("offset {} / {}", kPlatterAxes[j], report.unit),
        [j](const ResponseErrors& e) { return e.offset[j]; },
        [j](const ResponseErrors& e) { return e.u_offset[j]; });
  for (Eigen::Index j = 0; j < 3; ++j) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      if (report.as_found.gain(j, k) == 0.0 && report.predicted.gain(j, k) == 0.0) continue;
      row(
          j == k ? fmt::format("scale {} / ppm", kPlatterAxes[j])
                 : fmt::format("cross-axis {}{} / ppm", kPlatterAxes[j], kPlatterAxes[k]),
          [j, k](const ResponseErrors& e) { return 1e6 * e.gain(j, k); },
          [j, k](const ResponseErrors& e) { return 1e6 * e.u_gain(j, k); });
    }
  }
  row(
      "largest at 1 g / m/s2",
      [&](const ResponseErrors& e) { return e.worst_at_1g(report.unit_mps2) * report.unit_mps2; },
      [&](const ResponseErrors& e) { return e.u_offset.maxCoeff() * report.unit_mps2; });
  return text;
}

Json matrix_json(const Eigen::Matrix3d& m) {
  Json rows = Json::array();
  for (Eigen::Index j = 0; j < 3; ++j) rows.push_back({m(j, 0), m(j, 1), m(j, 2)});
  return rows;
}

Json errors_json(const ResponseErrors& errors, double unit_mps2) {
  const auto list = [](const Eigen::Vector3d& v) { return Json{v[0], v[1], v[2]}; };
  return {{"offset", list(errors.offset)},
          {"u_offset", list(errors.u_offset)},
          {"gain", matrix_json(errors.gain)},
          {"u_gain", matrix_json(errors.u_gain)},
          {"worst_at_1g_mps2", errors.worst_at_1g(unit_mps2) * unit_mps2}};
}

Json result_reference(const CalibrationResult& result) {
  return {{"source", result.source},
          {"estimator", result.estimator},
          {"verdict", to_string(result.verdict)},
          {"why", result.why}};
}

}  // namespace

std::string apply_text(const ApplyReport& report) {
  std::string text =
      fmt::format("Accelerometer {}{}, driver {}\n", report.model,
                  report.serial_number.empty() ? "" : " (SN " + report.serial_number + ")", report.driver);
  text += fmt::format("  {}\n", report.ability.rule);
  text += fmt::format("  Its registers hold {}.\n",
                      kShapeWords.of(report.ability.shape, "offsets, scales and angles between the axes"));
  text += fmt::format("  Their steps: {:.2g} {}", report.ability.offset_step, report.unit);
  if (report.ability.matrix_step > 0.0)
    text += fmt::format(", {:.2g} of a scale", report.ability.matrix_step);
  text += "\n";
  std::set<std::string> names;
  for (const RegisterTexts* registers : {&report.in_force, &report.before, &report.after})
    for (const auto& [name, value] : *registers) names.insert(name);
  for (const std::string& name : names) {
    const std::string in_force = content(report.in_force, name);
    const std::string before = content(report.before, name);
    const std::string after = content(report.after, name);
    text += fmt::format("  {}\n", name);
    if (!report.in_force.empty() && in_force != before) text += fmt::format("    in the run: {}\n", in_force);
    text += fmt::format("    old:        {}\n", before);
    text += fmt::format("    new:        {}\n", after == before ? "the same" : after);
  }
  if (!report.in_force.empty()) text += error_table(report);
  return text;
}

std::string outcome_text(const ApplyReport& report) {
  std::string text;
  if (report.as_left) text += error_table(report);
  if (report.left)
    text += fmt::format("  As found: {} ({}). As left: {} ({}).\n", report.found.source,
                        to_string(report.found.verdict), report.as_left_run.string(),
                        to_string(report.left->verdict));
  if (report.left)
    text += fmt::format(
        "  One certificate with both: abcal report {} --as-found {} --laboratory LAB.toml --dcc FILE, where "
        "[job] adjustment says what was written.\n",
        report.as_left_run.string(), report.found.source);
  text += fmt::format("State: {}", to_string(report.state));
  if (report.state == AdjustmentState::kVerified)
    text += report.ability.can_save ? "; lost when the instrument is switched off (--save keeps it)"
                                    : "; lost when the instrument is switched off";
  text += "\n";
  if (!report.log.empty()) text += fmt::format("Old registers: {}\n", report.log.string());
  return text;
}

nlohmann::ordered_json apply_json(const ApplyReport& report) {
  Json json{
      {"schema", "abcal.apply/1"},
      {"accelerometer", {{"model", report.model}, {"serial_number", report.serial_number}}},
      {"driver", report.driver},
      {"rule", report.ability.rule},
      {"holds", kShapeNames.of(report.ability.shape, "full")},
      {"steps", {{"offset", report.ability.offset_step}, {"matrix", report.ability.matrix_step}}},
      {"registers", {{"in_force", report.in_force}, {"before", report.before}, {"after", report.after}}},
      {"state", report.log.empty() ? "dry run" : std::string(to_string(report.state))},
      {"failure", report.failure},
      {"log", report.log.string()}};
  if (report.in_force.empty()) return json;  // A report of undo() has no calibration.
  json["unit"] = report.unit;
  json["errors"] = {{"as_found", errors_json(report.as_found, report.unit_mps2)},
                    {"predicted", errors_json(report.predicted, report.unit_mps2)},
                    {"as_left", nullptr}};
  json["as_found"] = result_reference(report.found);
  json["as_left"] = nullptr;
  if (report.as_left) json["errors"]["as_left"] = errors_json(*report.as_left, report.unit_mps2);
  if (report.left) {
    json["as_left"] = result_reference(*report.left);
    json["as_left"]["run"] = report.as_left_run.string();
  }
  return json;
}

}  // namespace abcal
