#include "app/results/report/calibration_document.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <optional>
#include <set>

#include "app/document/number_text.h"
#include "app/results/analysis/budget_words.h"
#include "app/results/analysis/coverage_words.h"
#include "app/results/analysis/effect_words.h"
#include "app/results/analysis/held_out_words.h"
#include "app/results/analysis/result_text.h"
#include "app/results/analysis/tray_results.h"
#include "app/results/report/first_page.h"
#include "app/results/report/run_figures.h"
#include "app/system/progress.h"
#include "protocol/estimators/checks/check_poses.h"
#include "protocol/plan/limits.h"
#include "protocol/quantities/output_names.h"
#include "protocol/record/run_operator.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {
namespace {

constexpr const char* kNotStated = "not stated";
constexpr const char* kNone = "-";

std::string or_not_stated(const std::string& text) {
  return text.empty() ? kNotStated : text;
}

std::string formatted(double value, const char* format = "{:.6g}") {
  return std::isfinite(value) ? without_negative_zero(fmt::format(fmt::runtime(format), value)) : kNone;
}
std::string formatted(const std::optional<double>& value, const char* format = "{:.6g}") {
  return value ? formatted(*value, format) : kNone;
}

/// Two digits of an uncertainty that may be of any size.
std::string two_digits(const std::optional<double>& u) {
  return formatted(u, "{:.1e}");
}

std::string to_the_second(const std::string& utc) {
  return utc.size() < 19 ? utc : utc.substr(0, 10) + " " + utc.substr(11, 8) + " UTC";
}

std::string capitalised(std::string text) {
  if (!text.empty()) text.front() = static_cast<char>(std::toupper(static_cast<unsigned char>(text.front())));
  return text;
}

// --- Item, bench and operator ------------------------------------------------------------------------------

Section item_section(const ReportData& data) {
  FactList facts;
  if (!data.run) {
    facts.facts = {{"Record", fmt::format("{}, a table without a run file: item, bench, operator and "
                                          "conditions are not part of it",
                                          data.path.filename().string())}};
    for (const std::string& line : data.record.read_as) facts.facts.emplace_back("How it was read", line);
    return {"Item", {facts}};
  }
  for (const IdentityPart& part : identity_of(data)) {
    std::string text = or_not_stated(part.stated);
    if (part.known_by() == KnownBy::kStated) text += " (stated, not read)";
    if (part.known_by() == KnownBy::kRead)
      text += part.stated == part.reported ? " (read from the instrument)"
                                           : fmt::format(" (the instrument reports {})", part.reported);
    facts.facts.emplace_back(capitalised(part.words), std::move(text));
  }
  for (const auto& [name, key] : kItemSettings)
    facts.facts.emplace_back(name, or_not_stated(data.label(key)));
  facts.facts.emplace_back("Unit of its response", data.record.response_unit);
  return {"Item", {facts}};
}

/// How the item was mounted, as the bench file states it.
Section mounting_section(const ReportData& data) {
  const std::string& mounting = data.record.expected.mounting;
  FactList facts{{{"u, v, w along", mounting}}};
  for (const auto& [name, key] : kItemMounting)
    facts.facts.emplace_back(name, or_not_stated(data.label(key)));
  return {"Mounting", {facts}};
}

Section run_section(const ReportData& data) {
  const StoredRun& run = *data.run;
  FactList facts{{{"Bench", or_not_stated(data.label("bench.name"))},
                  {"Operator", or_not_stated(describe(operators_of(run)))},
                  {"Begun", to_the_second(data.started_utc())},
                  {"Ended", to_the_second(data.ended_utc())},
                  {"State", fmt::format("{}: {} of {} angles measured", to_string(run.state),
                                        run.measured.size(), run.header.plan.size())}}};
  const int continuations = data.record.continuations;
  facts.facts.emplace_back(
      "Interruptions",
      continuations == 0 ? "none"
                         : fmt::format("continued {}",
                                       continuations == 1 ? "once" : fmt::format("{} times", continuations)));
  const RunTiming& t = run.timing;
  facts.facts.emplace_back(
      "Time", fmt::format("{}: moving {}, settling {}, reading {}, other {}", describe_duration(t.total_s()),
                          describe_duration(t.moving_s), describe_duration(t.settling_s),
                          describe_duration(t.dwelling_s), describe_duration(t.overhead_s)));
  DocumentTable instruments{"Instruments, as they identified themselves",
                            {{"role"}, {"maker and model"}, {"serial number"}, {"firmware"}, {"details"}},
                            {}};
  for (const InstrumentIdentity& i : run.header.instruments) {
    const std::string model = i.maker.empty() ? i.model : i.maker + " " + i.model;
    instruments.rows.push_back(
        {i.role, or_not_stated(model), or_not_stated(i.serial_number), or_not_stated(i.firmware), i.details});
  }
  return {"Bench and run", {facts, instruments}};
}

// --- Conditions --------------------------------------------------------------------------------------------

std::string gravity_text(const RunRecord& record) {
  const LocalGravity& g = record.g_loc;
  if (!record.g_loc_known) return "not known: sensitivities are per local gravity g_loc";
  std::string text = fmt::format("{:.9g} m/s²", g.value_mps2);
  text += g.expanded_uncertainty_mps2 > 0.0
              ? typeset_numbers(fmt::format(", U = {:.2g} m/s² (k = {:g})", g.expanded_uncertainty_mps2,
                                            g.coverage_factor))
              : ", uncertainty not stated";
  return text + "; source: " + or_not_stated(g.source);
}

std::string sensor_temperature_text(const RunRecord& record) {
  double sum = 0.0, lowest = 0.0, highest = 0.0;
  int count = 0;
  for (const DwellRecord& dwell : record.dwells) {
    if (!dwell.temperature_degc) continue;
    const double t = *dwell.temperature_degc;
    lowest = count == 0 ? t : std::min(lowest, t);
    highest = count == 0 ? t : std::max(highest, t);
    sum += t;
    ++count;
  }
  if (count == 0) return "not measured";
  return fmt::format("{:.2f} °C to {:.2f} °C, mean {:.2f} °C, at {} of {} angles", lowest, highest,
                     sum / count, count, record.dwells.size());
}

/// The runs of a measurement: how the item was mounted in each, and how far the results of each alone are
/// from that of all.
Section runs_section(const ReportData& data) {
  DocumentTable runs{"Runs, in the order of their beginning",
                     {{"run"},
                      {"begun"},
                      {"operator"},
                      {"mounting"},
                      {"angles", CellKind::kNumber},
                      {"flagged", CellKind::kNumber},
                      {"alone"}},
                     {}};
  DocumentTable alone{
      "Results of each run alone: the largest difference from that of all runs, in combined standard "
      "uncertainties, among s, phi and O",
      {{"run"}},
      {}};
  for (const std::string& estimator : estimator_names())
    alone.columns.push_back({estimator, CellKind::kNumber});
  DocumentTable files{"Files", {{"run"}, {"SHA-256"}}, {}};
  for (std::size_t k = 0; k < data.all->runs.size(); ++k) {
    const RunOfMeasurement& file = data.all->runs[k];
    const StoredRun& run = file.items.at(static_cast<std::size_t>(data.item) - 1);
    const SeriesMember& member = data.result().series[k];
    const std::string name = std::filesystem::path(file.file).filename().string();
    const auto flagged = std::ranges::count_if(
        run.record.dwells, [](const DwellRecord& dwell) { return dwell.flags != kFlagNone; });
    runs.rows.push_back({name, to_the_second(run.header.created_utc),
                         or_not_stated(describe(operators_of(run))), member.mounting,
                         std::to_string(run.measured.size()), std::to_string(flagged),
                         verdict_words(member.verdict)});
    std::vector<std::string> cells{name};
    for (const std::string& estimator : estimator_names()) {
      const auto each = std::ranges::find(member.alone, estimator, &Apart::estimator);
      cells.push_back(each == member.alone.end() ? kNone
                                                 : fmt::format("{:.1f} ({})", each->in_u, each->output));
    }
    alone.rows.push_back(std::move(cells));
    files.rows.push_back({name, file.sha256});
  }
  return {"Runs",
          {Paragraph{"The readings of all runs are fitted together: the item and the stage are common to "
                     "them, drifts, homing and how the item is mounted belong to each. Conditions, events "
                     "and flagged angles of a run are in its own report (abcal report RUN)."},
           std::move(runs), std::move(alone), std::move(files)}};
}

Section conditions_section(const ReportData& data) {
  Section section{"Conditions", {}};
  if (data.run) {
    DocumentTable room{"Room",
                       {{"moment"},
                        {"time (UTC)"},
                        {"temperature (°C)", CellKind::kNumber},
                        {"relative humidity (%)", CellKind::kNumber},
                        {"pressure (hPa)", CellKind::kNumber}},
                       {}};
    for (const StoredEnvironment& e : data.run->environment) {
      room.rows.push_back({e.moment, to_the_second(e.utc), formatted(e.temperature_degc),
                           formatted(e.humidity_percent), formatted(e.pressure_hpa)});
    }
    if (room.rows.empty()) {
      section.blocks.push_back(Paragraph{"Room: not recorded."});
    } else {
      section.blocks.push_back(std::move(room));
    }
  }
  section.blocks.push_back(FactList{{{"Sensor temperature", sensor_temperature_text(data.record)},
                                     {"Local gravity", gravity_text(data.record)}}});
  return section;
}

// --- Method ------------------------------------------------------------------------------------------------

std::string tolerances_text(const RunRecord& record) {
  const Tolerances& t = record.tolerances;
  std::string text = fmt::format(
      "Type B, from the stage's tolerances taken as standard uncertainties: alignment of the axes {:g} "
      "degree, each rotation step {:g} degree, initial turns {:g} degree, zeros of the axes {:g} degree; "
      "drift of the accelerometer over the run {:g} of its sensitivity.",
      t.alignment.deg(), t.step.deg(), t.initial_turn.deg(), t.zero.deg(), t.drift);
  const MeasuredAlignment& a = record.measured_alignment;
  if (a.zx || a.zy || a.xz)
    text += " The alignment was measured as well (abcal level); the joint estimator uses it.";
  return text;
}

/// The method of a run in which the stage turned.
Section constant_rate_method(const RunRecord& record) {
  Section section{"Method", {}};
  std::vector<double> rates;
  for (const DwellRecord& dwell : record.dwells) {
    if (!dwell.motion) continue;
    const double rate = std::round(dwell.motion->rate_deg_per_s * 10.0) / 10.0;
    if (std::ranges::find(rates, rate) == rates.end()) rates.push_back(rate);
  }
  section.blocks.push_back(Paragraph{
      fmt::format("Three rotation experiments in the local field of gravity at constant rates (M. Gaitan and "
                  "J. Geist, Measurement 189, 110528, 2022): 1 about the horizontal axis X; 2 about X with Z "
                  "turned by -90 degrees; 3 about Z with X turned by -90 degrees. In each the stage turns "
                  "through the circle at {:g} degree/s while the item is read, and the readings within half "
                  "a step about each of {} angles {:g} degrees apart are reduced to the value at that angle.",
                  fmt::join(rates, ", "), record.steps, record.step.deg())});
  section.blocks.push_back(
      Paragraph{"All angles are fitted together with the errors of the stage, the delay and the loss of "
                "amplitude of the item, and the positions of its elements; the results are those at rest. "
                "Uncertainty: type A from the scatter of the readings, autocorrelation taken into account; "
                "type B from the stated sizes of the effects."});
  return section;
}

/// The method of a table without angles.
Section pose_method(const RunRecord& record) {
  const bool directed = states_directions(record);
  Section section{
      "Method",
      {Paragraph{
           directed
               ? "Poses at rest in the local field of gravity, whose directions are stated. The specific "
                 "force has the "
                 "magnitude of local gravity, and the stated direction; the sensitivity matrix in the axes "
                 "of the mount "
                 "and the offsets follow by least squares (docs/theory/norm_estimator.md)."
               : "Poses at rest in the local field of gravity, whose angles are not known. At each pose the "
                 "specific force has the magnitude of local gravity; sensitivities, the angles between the "
                 "axes and offsets follow by least squares from readings in many directions. How the item "
                 "was "
                 "oriented, and so a matrix, does not (docs/theory/norm_estimator.md)."},
       Paragraph{
           "Uncertainty: type A from the stated uncertainties of the poses, or where there are none "
           "from the scatter of the magnitude, and of the directions where these are stated; type B from "
           "the stated sizes of the item's effects and the stated uncertainty of directions."}}};
  std::vector<std::string> left_out;
  for (const EffectSizeKey& key : effect_size_keys())
    if (key.section == "item_uncertainty" && key.get(record.tolerances) == 0.0 && key.in_motion == 0.0)
      left_out.emplace_back(key.key);
  section.blocks.push_back(Paragraph{
      fmt::format("Effects of the item that are not stated, and left out: {}.", fmt::join(left_out, ", "))});
  return section;
}

Section method_section(const ReportData& data) {
  const RunRecord& record = data.record;
  if (is_at_constant_rate(record)) return constant_rate_method(record);
  if (!has_angles(record)) return pose_method(record);
  Section section{"Method", {}};
  section.blocks.push_back(Paragraph{
      fmt::format("Three rotation experiments in the local field of gravity (ABC protocol: J. Geist and M. "
                  "Gaitan, J. Res. NIST 126, 126038, 2021): 1 about the horizontal axis X; 2 about X with Z "
                  "turned by -90 degrees; 3 about Z with X turned by -90 degrees; in each, {} angles {:g} "
                  "degrees apart. At each angle the stage stands still and the readings are averaged; a "
                  "sine, a cosine and a constant are fitted to the averages of each output by least squares, "
                  "and the sensitivity matrix and the offsets follow from the coefficients.",
                  record.steps, record.step.deg())});
  if (has_two_faces(record)) {
    section.blocks.push_back(Paragraph{
        "In two faces: of each experiment every second angle is measured with the axis that stands turned by "
        "180 degrees more, so that errors of the stage act on the item with the opposite sign."});
  }
  if (data.bench) {
    const ProtocolConfig& p = data.bench->protocol;
    const auto [least_s, most_s] = data.settle_times_s();
    std::string text =
        p.settle_auto
            ? fmt::format("Settling until the outputs were at rest ({:.2g} to {:.2g} s), ", least_s, most_s)
            : fmt::format("Settling at least {:g} s, ", p.settle_s);
    text += fmt::format("{} readings averaged at each angle; ", p.dwell_readings);
    text += p.approach.deg() != 0.0
                ? fmt::format("every angle is approached from below by {:g} degree; ", p.approach.deg())
                : std::string("angles are approached from either side; ");
    const char* const circle = p.faces == 2 ? "face" : "experiment";
    text += p.closing_angle ? fmt::format("at the end of each {} the first angle is measured again; ", circle)
                            : std::string("no closing angle; ");
    if (p.check_poses) {
      text +=
          "two check poses, gravity along (1, 1, 1) and against it, are measured at the start, between the "
          "experiments and at the end; ";
    }
    text += fmt::format("warm-up {:g} s.", p.warm_up_s);
    section.blocks.push_back(Paragraph{text});
  }
  section.blocks.push_back(
      Paragraph{"Uncertainty: type A from the scatter of the readings inside each dwell, autocorrelation "
                "taken into account. " +
                tolerances_text(record)});
  if (const std::vector<Term> defaults = unstated_effects(record.tolerances); !defaults.empty())
    section.blocks.push_back(Paragraph{fmt::format(
        "Effects whose size is not stated, so default sizes are used: {}.", fmt::join(defaults, "; "))});
  return section;
}

// --- Results -----------------------------------------------------------------------------------------------

/// Value and expanded uncertainty to two digits of the latter (ILAC-P14).
std::vector<std::string> result_row(const NamedQuantity& output) {
  const Quantity& q = output.quantity;
  if (!std::isfinite(q.value)) return {output.name, "not determined", kNone, kNone, kNone, kNone, q.unit};
  const double expanded = coverage_factor(q) * q.standard_uncertainty;
  const int decimals = decimals_for(expanded);
  return {output.name,
          with_decimals(q.value, decimals, true),
          std::isfinite(expanded) ? with_decimals(expanded, decimals) : kNone,
          two_digits(q.standard_uncertainty),
          two_digits(q.type_a),
          two_digits(q.type_b),
          q.unit};
}

/// Every value with all that its uncertainty consists of, and what a reader should know of the result.
Section values_section(const ReportData& data) {
  const CalibrationResult& result = data.result();
  Section section{"Values and uncertainties", {}};
  DocumentTable table{"",
                      {{"quantity", CellKind::kSymbol},
                       {"value", CellKind::kNumber},
                       {fmt::format("expanded unc. U (k = {:g})", kCoverageFactor), CellKind::kNumber},
                       {"standard unc. u", CellKind::kNumber},
                       {"type A", CellKind::kNumber},
                       {"type B", CellKind::kNumber},
                       {"unit", CellKind::kUnit}},
                      {}};
  const bool own_factors = own_coverage_factors(result);
  if (own_factors) {
    table.columns[2].heading = "expanded unc. U";
    table.columns.push_back({"k", CellKind::kNumber});
  }
  for (const auto& [about, values] : found_groups(result, QuantityKind::kOutput)) {
    table.rows.push_back({std::string(about.heading)});
    for (const NamedQuantity& output : values) {
      table.rows.push_back(result_row(output));
      if (own_factors) table.rows.back().push_back(formatted(coverage_factor(output.quantity), "{:.2f}"));
    }
  }
  section.blocks.push_back(std::move(table));
  section.blocks.push_back(Paragraph{fmt::format(
      "The expanded uncertainty is U = k u with {}. u: standard uncertainty, of type A (from the scatter of "
      "the readings) and type B (from what is stated of the stage and the item) combined.",
      own_factors ? fmt::format("the coverage factor k of Student's distribution with the degrees of freedom "
                                "of each output, for a coverage probability of 95.45 %")
                  : fmt::format("the coverage factor k = {:g}, which for a normal distribution corresponds "
                                "to a coverage probability of approximately {:g} %",
                                kCoverageFactor, 100.0 * kCoverageProbability))});
  if (const std::vector<Message> notes = further_notes(result, data.record.tolerances); !notes.empty())
    section.blocks.push_back(BulletList{{notes.begin(), notes.end()}});
  return section;
}

// --- Checks ------------------------------------------------------------------------------------------------

std::string with_sign(std::string text) {
  if (const std::size_t at = text.find("+-"); at != std::string::npos) text.replace(at, 2, "±");
  return text;
}

Section estimators_section(const ReportData& data) {
  DocumentTable table{"", {{"quantity", CellKind::kSymbol}}, {}};
  table.may_break = true;
  std::vector<std::vector<NamedQuantity>> columns;
  for (const CalibrationResult& result : data.results) {
    table.columns.push_back(
        {fmt::format("{} ({})", result.estimator, verdict_words(result.verdict)), CellKind::kNumber});
    columns.push_back(outputs(result));
  }
  const auto reported = static_cast<std::size_t>(&data.result() - data.results.data());
  for (std::size_t c = 0; c < data.results.size(); ++c) {
    if (c == reported) continue;
    table.columns.push_back({fmt::format("{} - {}, in u", data.results[c].estimator, data.result().estimator),
                             CellKind::kNumber});
  }
  for (std::size_t row = 0; row < columns.front().size(); ++row) {
    std::vector<std::string> cells{columns.front()[row].name};
    std::vector<std::string> differences;
    const auto known = [&](std::size_t c) {
      return data.results[c].verdict != Verdict::kNotUsable && std::isfinite(columns[c][row].quantity.value);
    };
    for (std::size_t c = 0; c < columns.size(); ++c) {
      const Quantity& q = columns[c][row].quantity;
      cells.push_back(known(c) ? with_sign(value_with_uncertainty(q)) : kNone);
      if (c == reported) continue;
      const Quantity& to = columns[reported][row].quantity;
      const double u = std::hypot(q.standard_uncertainty, to.standard_uncertainty);
      differences.push_back(known(reported) && known(c) ? formatted((q.value - to.value) / u, "{:+.2f}")
                                                        : kNone);
    }
    cells.insert(cells.end(), differences.begin(), differences.end());
    table.rows.push_back(std::move(cells));
  }
  std::string ways;
  for (const CalibrationResult& result : data.results)
    ways += (ways.empty() ? "" : "; ") + result.estimator + find_estimator(result.estimator).words;
  Section section{
      "Estimators side by side",
      {Paragraph{fmt::format("Several ways to the same quantities, as a check of each other: {}. Values with "
                             "standard uncertainty; differences in combined standard uncertainties.",
                             ways)},
       std::move(table)}};
  BulletList reasons;
  for (const CalibrationResult& result : data.results)
    reasons.items.push_back(
        fmt::format("{}: {}: {}", result.estimator, verdict_words(result.verdict), result.why));
  section.blocks.push_back(std::move(reasons));
  return section;
}

/// One row a check, the three outputs side by side, each with how many standard uncertainties it is from
/// zero.
DocumentTable check_table(std::string caption, const std::string& what, const std::string& unit) {
  DocumentTable table{std::move(caption), {{what, CellKind::kSymbol}}, {}};
  for (const char* output : kOutputNames) {
    table.columns.push_back({fmt::format("output {} ({})", output, unit), CellKind::kNumber});
    table.columns.push_back({"in unc.", CellKind::kNumber});
  }
  return table;
}

/// Fills in one cell pair; the outputs of a check stand one behind the other.
void add_check(DocumentTable& table, const std::string& name, int accelerometer, const Quantity& q) {
  if (table.rows.empty() || table.rows.back().front() != name) {
    table.rows.emplace_back(table.columns.size(), kNone);
    table.rows.back().front() = name;
  }
  const std::size_t cell = 1 + 2 * static_cast<std::size_t>(accelerometer);
  table.rows.back()[cell] =
      fmt::format("{} ± {}", formatted(q.value, "{:+.2e}"), two_digits(q.standard_uncertainty));
  table.rows.back()[cell + 1] = formatted(q.value / q.standard_uncertainty, "{:+.1f}");
}

DocumentTable check_pose_table(const CheckPoseStudy& study, const std::string& unit) {
  DocumentTable table = check_table(
      "Check poses measured again, minus their first readings (uncertainty of the two readings alone). What "
      "drift and stage explain of it: see the plausibility checks.",
      "visit, pose", unit);
  for (const PoseDifference& difference : study.differences) {
    for (int j = 0; j < 3; ++j) {
      Quantity q;
      q.value = difference.value(j);
      q.standard_uncertainty = difference.standard_uncertainty(j);
      add_check(table, fmt::format("{}, {}", difference.visit + 1, difference.pose), j, q);
    }
  }
  return table;
}

DocumentTable faces_table(const FaceResults& faces, const std::string& unit) {
  DocumentTable table = check_table(
      "ABC result of face 1 minus that of face 2; zero for a perfect stage. s per g_loc.", "result", unit);
  constexpr std::array<const char*, 4> kNames{"s, x", "s, y", "s, z", "O"};
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t i = 0; i < kNames.size(); ++i)
      add_check(table, kNames[i], static_cast<int>(j),
                i < 3 ? faces.difference.sensitivity_matrix[j][i] : faces.difference.offset[j]);
  }
  return table;
}

Section closures_section(const CalibrationResult& result, const std::optional<CheckPoseStudy>& check_poses) {
  const Diagnostics& d = result.diagnostics;
  const std::optional<FaceResults>& faces = result.faces;
  const std::string& unit = result.response_unit;
  Section section{"Closures", {}};
  if (!d.closures.empty()) {
    DocumentTable table = check_table(
        "Combinations of the coefficients of different experiments that vanish for a perfect stage, with "
        "their standard uncertainty, which covers readings and tolerances.",
        "closure", unit);
    for (const Closure& closure : d.closures)
      add_check(table, closure.name, closure.accelerometer, closure.value);
    section.blocks.push_back(std::move(table));
  }
  if (faces) section.blocks.push_back(faces_table(*faces, unit));
  if (!d.closing_differences.empty()) {
    DocumentTable table =
        check_table("First angle measured again at the end of each experiment, minus the first reading.",
                    "experiment", unit);
    for (const ClosingDifference& c : d.closing_differences)
      add_check(table, std::to_string(c.experiment), c.accelerometer, c.value);
    section.blocks.push_back(std::move(table));
  }
  if (check_poses) section.blocks.push_back(check_pose_table(*check_poses, unit));
  return section;
}

Section plausibility_section(const Diagnostics& d) {
  DocumentTable table{
      "What slips, missed steps, jumps, drift, a wrong scale or exchanged outputs would show.",
      {{"check"}, {"found", CellKind::kNumber}, {"limit", CellKind::kNumber}, {"unit"}, {"outcome"}},
      {}};
  table.may_break = true;
  for (const Check& check : d.checks) {
    if (!std::isfinite(check.found)) continue;  // not done: a note says why
    table.rows.push_back({check.name, formatted(check.found, "{:.2g}"), formatted(check.limit, "{:.2g}"),
                          check.unit, check.passed ? "passed" : "FAILED"});
  }
  return {"Plausibility checks", {std::move(table)}};
}

Section fits_section(const ReportData& data) {
  const CalibrationResult& result = result_of(data.results, kPublishedEstimator);
  const std::string& unit = result.response_unit;
  DocumentTable table{
      fmt::format("Residuals of the fits (rms) and amplitudes of harmonics 2 to 5, which an ideal "
                  "accelerometer on an ideal stage does not have; in {}.",
                  unit),
      {{"experiment"}, {"output"}, {"angles", CellKind::kNumber}, {"residual rms", CellKind::kNumber}},
      {}};
  for (int order = 2; order <= 5; ++order)
    table.columns.push_back({fmt::format("harmonic {}", order), CellKind::kNumber});
  table.columns.push_back({"u of a harmonic", CellKind::kNumber});
  for (const FitDiagnostic& fit : result.diagnostics.fits) {
    std::vector<std::string> row{std::to_string(fit.experiment),
                                 kOutputNames.at(static_cast<std::size_t>(fit.accelerometer)),
                                 std::to_string(fit.angles), formatted(fit.residual_rms, "{:.2e}")};
    double u = std::numeric_limits<double>::quiet_NaN();
    for (int order = 2; order <= 5; ++order) {
      const auto found = std::find_if(fit.harmonics.begin(), fit.harmonics.end(),
                                      [&](const Harmonic& h) { return h.order == order; });
      if (found == fit.harmonics.end()) {
        row.emplace_back(kNone);
        continue;
      }
      row.push_back(formatted(std::hypot(found->sin_amplitude.value, found->cos_amplitude.value), "{:.2e}"));
      u = std::fmax(
          u, std::fmax(found->sin_amplitude.standard_uncertainty, found->cos_amplitude.standard_uncertainty));
    }
    row.push_back(formatted(u, "{:.1e}"));
    table.rows.push_back(std::move(row));
  }
  Section section{"Fits and harmonics", {}};
  for (int experiment = 1; experiment <= 3; ++experiment)
    section.blocks.push_back(response_figure(data, experiment));
  section.blocks.push_back(std::move(table));
  section.blocks.push_back(harmonics_figure(result));
  return section;
}

DocumentTable model_equation_table(const ModelEquation& equation) {
  DocumentTable table{
      "Model equation at zero, K0 + K1 a + K2 a² + K3 a³ along each output's own axis. It is not the result, "
      "which is the line response over all directions of gravity.",
      {{"quantity", CellKind::kSymbol},
       {"value", CellKind::kNumber},
       {"standard unc. u", CellKind::kNumber},
       {"unit", CellKind::kUnit}},
      {}};
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t order = 0; order < 4; ++order) {
      const Quantity& k = equation.k[j][order];
      if (!std::isfinite(k.value)) continue;
      const int decimals = decimals_for(k.standard_uncertainty);
      table.rows.push_back({fmt::format("K{}_{}", order, kOutputNames[j]),
                            with_decimals(k.value, decimals, true), two_digits(k.standard_uncertainty),
                            k.unit});
    }
  }
  return table;
}

Section stage_section(const RunRecord& record, const CalibrationResult& result) {
  const JointResult& joint = *result.joint;
  DocumentTable table{
      "Errors of the stage and the accelerometer that the joint estimator finds in the same readings.",
      {{"quantity", CellKind::kSymbol},
       {"value", CellKind::kNumber},
       {"standard unc. u", CellKind::kNumber},
       {"unit", CellKind::kUnit}},
      {}};
  for (const QuantityKind kind : {QuantityKind::kStage, QuantityKind::kAccelerometer})
    for (const auto& [about, values] : found_groups(result, kind))
      for (const auto& [name, q] : values)
        if (std::isfinite(q.value))
          table.rows.push_back(
              {name, formatted(q.value, "{:+.3e}"), two_digits(q.standard_uncertainty), q.unit});
  Section section{"Stage and drift, by the joint estimator", {std::move(table)}};
  if (result.model_equation) section.blocks.push_back(model_equation_table(*result.model_equation));
  if (!joint.nonlinearity_fitted)
    section.blocks.push_back(Paragraph{"k2, k3: not fitted, because the readings show no non-linearity."});
  section.blocks.push_back(step_error_figure(record, joint));
  return section;
}

/// The response at each rate of a run at constant rates, and what belongs to the turning.
Section motion_section(const CalibrationResult& result) {
  const MotionResult& motion = *result.joint->motion;
  DocumentTable responses{
      fmt::format("Amplitude relative to rest, and phase beyond that of a pure delay, each with its expanded "
                  "uncertainty U (k = {:g}). At rest the response is that of the result.",
                  kCoverageFactor),
      {{"rate (degree/s)", CellKind::kNumber},
       {"frequency (Hz)", CellKind::kNumber},
       {"output"},
       {"amplitude (1)", CellKind::kNumber},
       {"U (1)", CellKind::kNumber},
       {"phase (degree)", CellKind::kNumber},
       {"U (degree)", CellKind::kNumber}},
      {}};
  const auto both = [](const Quantity& q) {
    const double expanded = kCoverageFactor * q.standard_uncertainty;
    return std::array<std::string, 2>{with_decimals(q.value, decimals_for(expanded), true),
                                      two_digits(expanded)};
  };
  for (const RateResponse& response : motion.responses) {
    for (std::size_t j = 0; j < 3; ++j) {
      const auto [amplitude, u_amplitude] = both(response.amplitude[j]);
      const auto [phase, u_phase] = both(response.phase);
      responses.rows.push_back({fmt::format("{:.4g}", response.rate_deg_per_s),
                                fmt::format("{:.4f}", response.frequency_hz), kOutputNames[j], amplitude,
                                u_amplitude, j == 0 ? phase : "", j == 0 ? u_phase : ""});
    }
  }
  DocumentTable others{"Delays, places of the elements, and offsets with the rate.",
                       {{"quantity"},
                        {"value", CellKind::kNumber},
                        {"standard unc. u", CellKind::kNumber},
                        {"unit", CellKind::kUnit}},
                       {}};
  for (const auto& [about, values] : found_groups(result, QuantityKind::kMotion)) {
    others.rows.push_back({capitalised(about.meaning)});
    for (const auto& [name, q] : values)
      if (std::isfinite(q.value))
        others.rows.push_back({name, with_decimals(q.value, decimals_for(q.standard_uncertainty), true),
                               two_digits(q.standard_uncertainty), q.unit});
  }
  return {"Response at each rate", {std::move(responses), rate_response_figure(motion), std::move(others)}};
}

/// The items that were measured with this one.
Section tray_section(const AnalysedRun& run) {
  DocumentTable table{"Items of this run. The stage is estimated once, from those of the common fit.",
                      {{"item"}, {"verdict"}, {"common fit"}},
                      {}};
  const std::vector<RunItem>& identities = run.items.front().stored.header.items;
  for (std::size_t k = 0; k < identities.size(); ++k) {
    const TrayItemResult& item = run.joint.items[k];
    table.rows.push_back({item_words(identities[k]), verdict_words(item.result.verdict),
                          item.in_common_fit ? "yes" : "no: " + item.why_not});
  }
  Section section{"Items measured together", {std::move(table)}};
  section.blocks.push_back(
      Paragraph{fmt::format("All items: {}: {}.", verdict_words(run.joint.verdict), run.joint.why)});
  return section;
}

// --- Budget ------------------------------------------------------------------------------------------------

/// The part of a budget's line in an output, which may be nothing but rounding.
bool contributes(const Budget& budget, const BudgetLine& line, int k) {
  constexpr double kRounding = 1e-9;  // Relative to the combined uncertainty.
  return !(line.contribution(k) < kRounding * budget.combined(k));
}

/// All inputs once, with the sensitivity of each of these outputs.
DocumentTable inputs_table(const Budget& budget, const std::vector<int>& outputs) {
  DocumentTable table{
      "Inputs x with their degrees of freedom ν, standard uncertainties u(x), and sensitivities c to them.",
      {{"input x", CellKind::kSymbol},
       {"unit", CellKind::kUnit},
       {"type", CellKind::kUnit},
       {"ν", CellKind::kNumber},
       {"u(x)", CellKind::kNumber}},
      {}};
  table.dense = table.may_break = true;
  for (const int k : outputs)
    table.columns.push_back({fmt::format("c({})", output_symbol(k)), CellKind::kNumber});
  for (const BudgetLine& line : budget.lines) {
    const std::string degrees = degrees_words(line, outputs);
    std::vector<std::string> row{
        line.input, line.unit, fmt::format("{} {}", line.type_a ? "A" : "B", line.distribution),
        degrees.empty() ? "∞" : degrees, formatted(line.standard_uncertainty, "{:.1e}")};
    for (const int k : outputs)
      row.push_back(contributes(budget, line, k) ? formatted(line.sensitivity(k), "{:.1e}") : "");
    table.rows.push_back(std::move(row));
  }
  return table;
}

DocumentTable contributions_table(const Budget& budget, const std::vector<int>& outputs,
                                  const std::string& response_unit) {
  constexpr double kLeastShown = 0.0005;  // Rounds to 0.1 %.
  std::string units;
  for (const int k : outputs)
    units +=
        fmt::format("{}{} in {}", units.empty() ? "" : ", ", output_symbol(k), output_unit(k, response_unit));
  DocumentTable table{
      fmt::format("Contributions |c| u(x) to the uncertainty, and shares of the variance from 0.1 % on: {}.",
                  units),
      {{"input x", CellKind::kSymbol}},
      {}};
  table.dense = table.may_break = true;
  table.caption_kind = CellKind::kSymbol;
  for (const int k : outputs) {
    table.columns.push_back({std::string(output_symbol(k)), CellKind::kNumber});
    table.columns.push_back({"share", CellKind::kNumber});
  }
  for (const BudgetLine& line : budget.lines) {
    if (std::ranges::none_of(outputs, [&](int k) { return contributes(budget, line, k); })) continue;
    std::vector<std::string> row{line.input};
    for (const int k : outputs) {
      const double share = budget.share(line, k);
      row.push_back(contributes(budget, line, k) ? formatted(line.contribution(k), "{:.1e}") : "");
      row.push_back(share >= kLeastShown ? fmt::format("{:.1f} %", 100.0 * share) : "");
    }
    table.rows.push_back(std::move(row));
  }
  std::vector<std::string> combined{"combined"};
  for (const int k : outputs) {
    combined.push_back(formatted(budget.combined(k), "{:.1e}"));
    combined.emplace_back("100 %");
  }
  table.rows.push_back(std::move(combined));
  return table;
}

Section budget_section(const ReportData& data) {
  const Budget& budget = *data.budget;
  const std::vector<int> outputs = worst_of_each_kind(budget.combined);
  Section section{
      "Uncertainty budget",
      {Paragraph{fmt::format("Of the {} estimator, to first order (JCGM 100), for the output with the "
                             "largest uncertainty of each kind.",
                             data.estimator)},
       inputs_table(budget, outputs), contributions_table(budget, outputs, data.record.response_unit)}};
  std::vector<std::string> in_si;
  for (const int k : outputs)
    if (std::string words = gravity_words(budget, k, data.record.response_unit); !words.empty())
      in_si.push_back(std::move(words));
  if (!in_si.empty()) section.blocks.push_back(BulletList{std::move(in_si)});
  FactList sources;
  for (auto& [source, inputs] : budget_sources(budget))
    sources.facts.emplace_back("Source: " + source, std::move(inputs));
  section.blocks.push_back(std::move(sources));
  section.blocks.push_back(Paragraph{fmt::format("Not covered: {}.", fmt::join(budget.not_covered, "; "))});
  if (data.held_out_norm)
    section.blocks.push_back(Paragraph{"Check of U by " + held_out_words(*data.held_out_norm) + "."});
  if (!budget.notes.empty()) section.blocks.push_back(BulletList{budget.notes});
  return section;
}

// --- Flags and events --------------------------------------------------------------------------------------

Section flags_section(const ReportData& data) {
  constexpr std::size_t kMostShown = 40;
  Section section{"Flags and events", {}};
  DocumentTable flagged{"Flagged angles", {{"experiment"}, {"angle", CellKind::kNumber}, {"flags"}}, {}};
  std::size_t count = 0;
  for (const DwellRecord& dwell : data.record.dwells) {
    if (dwell.flags == kFlagNone || ++count > kMostShown) continue;
    flagged.rows.push_back({fmt::format("{}{}", dwell.experiment, dwell.face == 2 ? ", face 2" : ""),
                            fmt::format("{:g}", dwell.alpha.deg()), describe_flags(dwell.flags)});
  }
  if (count > kMostShown) flagged.rows.push_back({fmt::format("and {} more", count - kMostShown)});
  if (count > 0) {
    section.blocks.push_back(std::move(flagged));
  } else if (data.run) {
    section.blocks.push_back(Paragraph{"No angle is flagged."});
  } else {
    section.blocks.push_back(Paragraph{"A table carries no flags and no events."});
  }
  if (!data.run) return section;
  DocumentTable events{"Events", {{"time (UTC)"}, {"kind"}, {"text"}}, {}};
  for (const RunEvent& event : data.run->events) {
    // Flags are in the table of angles.
    if (event.kind != "flag") events.rows.push_back({to_the_second(event.utc), event.kind, event.text});
  }
  if (!events.rows.empty()) section.blocks.push_back(std::move(events));
  return section;
}

Section origin_section(const ReportData& data) {
  FactList facts{{{"Raw data", data.path.filename().string()},
                  {"SHA-256", data.sha256.value_or("none: only a closed run has one")}}};
  for (const IntegrityCheck& check : data.integrity) {
    if (check.what == "SHA-256" && check.good) continue;
    facts.facts.emplace_back("Integrity, " + check.what,
                             (check.good ? "good: " : "NOT GOOD: ") + check.found);
  }
  if (data.run) facts.facts.emplace_back("Measured with", "abcal " + data.run->header.program_version);
  facts.facts.emplace_back("Analysed and reported with", "abcal " + data.program_version);
  facts.facts.emplace_back("Report made", to_the_second(data.created_utc));
  return {"Raw data and program", {facts}};
}

std::string identification(const ReportData& data) {
  std::string text = data.path.filename().string();
  const std::string item = data.label("item.model"), serial = data.label("item.serial_number");
  if (!item.empty()) text += " · " + item;
  if (!serial.empty()) text += " · serial number " + serial;
  if (identity_of(data).back().known_by() == KnownBy::kStated) text += " (stated, not read)";
  constexpr std::size_t kShort = 16;  // of 64 digits: enough to distinguish runs; the report contains all
  if (data.sha256) text += " · SHA-256 " + data.sha256->substr(0, kShort) + "...";
  return text;
}

}  // namespace

Document calibration_document(const ReportData& data) {
  Document document;
  document.title = "Calibration report: triaxial accelerometer";
  document.subtitle = identification(data);
  document.identification = identification(data);
  document.origin =
      fmt::format("abcal {}, report made {}", data.program_version, to_the_second(data.created_utc));
  document.created_utc = data.created_utc;
  document.cautions = cautions(data);
  const bool usable = data.result().verdict != Verdict::kNotUsable;
  document.sections.push_back(first_page(data));
  document.sections.push_back(item_section(data));
  // With both tables, drawing and figure the result fills its page.
  document.sections.back().on_new_page = usable && data.result().sensitivity_matrix.has_value();
  if (data.run) document.sections.push_back(mounting_section(data));
  if (usable) document.sections.push_back(values_section(data));
  const bool one_run = !data.is_of_several_runs();
  if (!one_run) document.sections.push_back(runs_section(data));
  if (data.run && one_run) document.sections.push_back(run_section(data));
  if (one_run) document.sections.push_back(conditions_section(data));
  document.sections.push_back(method_section(data));
  const CalibrationResult& result = data.result();
  if (result.verdict != Verdict::kNotUsable && one_run && has_angles(data.record)) {
    document.sections.push_back(estimators_section(data));
    // The fits of the published protocol show the stage, whichever estimator is reported.
    const CalibrationResult& published = result_of(data.results, kPublishedEstimator);
    const Section closures = closures_section(published, compared_check_poses(data.record));
    if (!closures.blocks.empty()) document.sections.push_back(closures);
    if (!published.diagnostics.fits.empty()) document.sections.push_back(fits_section(data));
  }
  if (result.verdict != Verdict::kNotUsable) {
    for (const CalibrationResult& each : data.results) {
      if (each.joint && each.verdict != Verdict::kNotUsable)
        document.sections.push_back(stage_section(data.record, each));
      if (each.joint && each.joint->motion && each.verdict != Verdict::kNotUsable)
        document.sections.push_back(motion_section(each));
    }
    if (data.is_one_of_several()) document.sections.push_back(tray_section(*data.all));
    if (data.budget) document.sections.push_back(budget_section(data));
  }
  if (!result.diagnostics.checks.empty())
    document.sections.push_back(plausibility_section(result.diagnostics));
  if (one_run) document.sections.push_back(flags_section(data));
  document.sections.push_back(origin_section(data));
  return document;
}

}  // namespace abcal
