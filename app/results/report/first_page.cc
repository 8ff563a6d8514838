#include "app/results/report/first_page.h"

#include <fmt/format.h>

#include <array>
#include <cctype>
#include <cmath>

#include "app/results/analysis/effect_words.h"
#include "app/results/analysis/result_text.h"
#include "app/results/report/mounting_figure.h"
#include "app/results/report/run_figures.h"
#include "protocol/plan/limits.h"
#include "protocol/quantities/output_names.h"
#include "protocol/quantities/quantity_groups.h"

namespace abcal {
namespace {

/// "+1.002103 ± 0.000007": value and expanded uncertainty, to two digits of the latter (ILAC-P14).
std::string value_and_u(const Quantity& q) {
  if (!std::isfinite(q.value)) return "not determined";
  const double expanded = coverage_factor(q) * q.standard_uncertainty;
  const int decimals = decimals_for(expanded);
  return with_decimals(q.value, decimals, true) +
         (std::isfinite(expanded) ? " ± " + with_decimals(expanded, decimals) : "");
}

DocumentTable matrix_table(const CalibrationResult& result) {
  const auto& matrix = *result.sensitivity_matrix;
  DocumentTable table{
      "Sensitivity matrix s ± U in " + matrix[0][0].unit + ", at the default orientation",
      {{"", CellKind::kSymbol}, {"x", CellKind::kNumber}, {"y", CellKind::kNumber}, {"z", CellKind::kNumber}},
      {}};
  table.caption_kind = CellKind::kUnit;
  for (std::size_t j = 0; j < 3; ++j)
    table.rows.push_back(
        {kOutputNames[j], value_and_u(matrix[j][0]), value_and_u(matrix[j][1]), value_and_u(matrix[j][2])});
  return table;
}

DocumentTable intrinsic_table(const CalibrationResult& result) {
  const std::string s = result.intrinsic_sensitivity[0].unit, offset = result.offset[0].unit;
  DocumentTable table{"Whatever the mounting: sensitivities s in " + s +
                          ", angles between the axes, offsets O in " + offset + ", each ± U",
                      {{"", CellKind::kSymbol},
                       {"s", CellKind::kNumber},
                       {"", CellKind::kSymbol},
                       {"angle (°)", CellKind::kNumber},
                       {"", CellKind::kSymbol},
                       {"O", CellKind::kNumber}},
                      {}};
  table.caption_kind = CellKind::kUnit;
  for (std::size_t j = 0; j < 3; ++j)
    table.rows.push_back({fmt::format("s_{}", kOutputNames[j]), value_and_u(result.intrinsic_sensitivity[j]),
                          fmt::format("phi_{}", kOutputPairs[j]), value_and_u(result.intrinsic_angle[j]),
                          fmt::format("O_{}", kOutputNames[j]), value_and_u(result.offset[j])});
  return table;
}

/// Outputs beyond those of the protocol; no rows: there are none.
DocumentTable further_table(const CalibrationResult& result) {
  DocumentTable table{"Further outputs, each ± U",
                      {{"", CellKind::kSymbol}, {"value", CellKind::kNumber}, {"unit", CellKind::kUnit}},
                      {}};
  for (const auto& [about, values] : further_outputs(result)) {
    table.rows.push_back({std::string(about.heading)});
    for (const auto& [name, quantity] : values)
      table.rows.push_back({name, value_and_u(quantity), quantity.unit});
  }
  return table;
}

std::string equation_words(const ReportData& data) {
  const std::string g = data.record.g_loc_known
                            ? fmt::format("local gravity, {:.9g} m/s²", data.record.g_loc.value_mps2)
                            : "local gravity, which is not known";
  return fmt::format(
      "Readings r = (u, v, w) follow from the specific force a = (x, y, z) by r = s a + O, and a from the "
      "readings by a = s⁻¹ (r − O); a is in units of {}.",
      g);
}

/// Drawing of the item on the platter, of a run that states its mounting.
void add_mounting(const ReportData& data, Section& section) {
  if (!data.run) return;
  const auto directions = mounting_matrix(data.record.expected.mounting);
  if (!directions) return;
  MountingWords words{
      "Stated mounting: u, v, w of the item, and x, y, z of the platter at the default orientation."};
  if (const std::string text = data.label("item.reference_surface"); !text.empty())
    words.surface = "Reference surface: " + text;
  if (const std::string text = data.label("item.direction_marks"); !text.empty())
    words.marks = "Direction marks: " + text;
  section.blocks.emplace_back(mounting_figure(*directions, words));
}

/// The verdict, and the values of a result that has some.
void add_result(const CalibrationResult& result, Section& section) {
  std::string verdict = verdict_words(result.verdict);
  verdict.front() = static_cast<char>(std::toupper(static_cast<unsigned char>(verdict.front())));
  section.blocks.push_back(
      Paragraph{fmt::format("{} ({} estimator): {}.", verdict, result.estimator, result.why)});
  if (result.verdict == Verdict::kNotUsable) {
    section.blocks.push_back(Paragraph{"No numbers are given, because the result is not usable."});
    return;
  }
  if (result.sensitivity_matrix) section.blocks.push_back(matrix_table(result));
  section.blocks.push_back(intrinsic_table(result));
  if (DocumentTable further = further_table(result); !further.rows.empty())
    section.blocks.push_back(std::move(further));
}

}  // namespace

Section result_section(const CalibrationResult& result, std::optional<double> nominal) {
  Section section;
  add_result(result, section);
  if (result.verdict == Verdict::kNotUsable) return section;
  section.blocks.push_back(Paragraph{"U: expanded uncertainty, for a coverage probability of 95.45 %."});
  section.blocks.push_back(deviation_figure(result, nominal));
  return section;
}

Section first_page(const ReportData& data) {
  const CalibrationResult& result = data.result();
  Section section{"Result", {}};
  add_result(result, section);
  if (result.verdict == Verdict::kNotUsable) {
    if (const std::vector<Message> notes = further_notes(result, data.record.tolerances); !notes.empty())
      section.blocks.push_back(BulletList{{notes.begin(), notes.end()}});
    add_mounting(data, section);
    return section;
  }
  section.blocks.push_back(
      Paragraph{"U: expanded uncertainty, for a coverage probability of 95.45 %. The section Values and "
                "uncertainties has k, and the glossary (docs/glossary.md) the terms."});
  if (result.sensitivity_matrix) section.blocks.push_back(Paragraph{equation_words(data)});
  add_mounting(data, section);
  section.blocks.push_back(deviation_figure(
      result,
      nominal_response(data.record.expected, data.record.response_unit, data.record.g_loc.value_mps2)));
  return section;
}

}  // namespace abcal
