#include "app/results/analysis/result_summary.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "app/results/analysis/budget_words.h"
#include "app/results/analysis/effect_words.h"
#include "app/results/analysis/result_text.h"
#include "app/results/analysis/size_costs.h"
#include "app/results/analysis/tray_results.h"
#include "app/system/output.h"
#include "app/system/terminal.h"
#include "app/system/text_layout.h"
#include "protocol/quantities/output_names.h"
#include "protocol/record/run_label.h"
#include "protocol/uncertainty/budget.h"

namespace abcal {
namespace {

constexpr const char* kKeysCommand = "abcal plan --keys";
constexpr const char* kU = "U: expanded uncertainty, for a coverage probability of 95.45 %";

/// A warning, and the command or the page that leads on.
struct Warning {
  std::string words;
  std::string leads_to;
  std::vector<std::string> lines = {};  ///< Shown as they are between both.
  bool at_first_sight = false;          ///< On the first screen as well: without it the result would mislead.
};

/// Names of a bench file may hold anything: nothing of it may move the cursor or leave the line.
std::string block(const std::string& text, const std::string& first, const std::string& next) {
  return wrapped(printable_line(text), first, next, kTerminalColumns, LongWords::kBreak);
}

std::string heading(std::FILE* stream, const std::string& text) {
  return emphasised(stream, Emphasis::kHeading, text) + "\n";
}

/// "Result: usable (joint estimator): the reason".
std::string verdict_block(Verdict verdict, const std::string& whose, const std::string& why,
                          std::FILE* stream) {
  const std::string words = verdict_words(verdict), intro = "Result: ";
  std::string text = block(fmt::format("{}{} ({}): {}", intro, words, whose, why), "", "  ");
  const Emphasis emphasis = verdict == Verdict::kUsable     ? Emphasis::kGood
                            : verdict == Verdict::kDoubtful ? Emphasis::kWarning
                                                            : Emphasis::kBad;
  return emphasised(stream, Emphasis::kHeading, intro) + emphasised(stream, emphasis, words) +
         text.substr(intro.size() + words.size());
}

std::string item_line(const StoredRun& stored) {
  const auto label = [&](const char* key) { return label_of(stored.header.labels, key); };
  std::string name = label("item.maker");
  if (const std::string model = label("item.model"); !model.empty())
    name += (name.empty() ? "" : " ") + model;
  if (const std::string serial = label("item.serial_number"); !serial.empty())
    name += (name.empty() ? "serial number " : ", serial number ") + serial;
  return name.empty() ? "" : block("Item: " + name, "", "  ");
}

/// Value and expanded uncertainty, to two digits of the latter.
std::string with_expanded(const Quantity& q) {
  if (!std::isfinite(q.value)) return "not determined";
  const double expanded = coverage_factor(q) * q.standard_uncertainty;
  const int decimals = decimals_for(expanded);
  return fmt::format("{} +- {}", with_decimals(q.value, decimals, true),
                     std::isfinite(expanded) ? with_decimals(expanded, decimals) : "unknown");
}

/// A cell of a table: its name is shown where it does not follow from row and column.
struct Cell {
  std::string name, value, unit;
};
using Cells = std::array<std::array<Cell, 3>, 3>;

/// Three rows of three, or one cell a line where three side by side are too wide.
std::string table(const Cells& cells, const std::array<std::string, 3>& headings) {
  std::array<std::size_t, 3> widths{};
  for (std::size_t c = 0; c < 3; ++c) {
    widths[c] = display_width(headings[c]);
    for (const auto& row : cells) widths[c] = std::max(widths[c], display_width(row[c].value));
  }
  constexpr std::size_t kBefore = 5, kBetween = 2;
  std::string text;
  if (kBefore + widths[0] + widths[1] + widths[2] + 2 * kBetween > kTerminalColumns) {
    for (const auto& row : cells) {
      for (const Cell& cell : row)
        text += block(fmt::format("{} {}", cell.value, cell.unit), fmt::format("  {:<8}", cell.name),
                      std::string(10, ' '));
    }
    return text;
  }
  const auto line = [&](std::string_view name, const auto& cell_of) {
    std::string out = fmt::format("  {:<3}", name);
    for (std::size_t c = 0; c < 3; ++c) {
      if (c > 0) out += std::string(kBetween, ' ');
      out += padded(cell_of(c), widths[c]);
    }
    return out.substr(0, out.find_last_not_of(' ') + 1) + "\n";
  };
  text += line("", [&](std::size_t c) { return headings[c]; });
  for (std::size_t j = 0; j < 3; ++j)
    text += line(kOutputNames[j], [&](std::size_t c) { return cells[j][c].value; });
  return text;
}

std::string intrinsic_table(const CalibrationResult& result, std::FILE* stream) {
  Cells cells;
  for (std::size_t j = 0; j < 3; ++j) {
    const auto cell = [](std::string name, const Quantity& q) {
      return Cell{std::move(name), with_expanded(q), q.unit};
    };
    cells[j] = {cell(fmt::format("s_{}", kOutputNames[j]), result.intrinsic_sensitivity[j]),
                cell(fmt::format("phi_{}", kOutputPairs[j]), result.intrinsic_angle[j]),
                cell(fmt::format("O_{}", kOutputNames[j]), result.offset[j])};
    cells[j][1].value = fmt::format("{} {}", kOutputPairs[j], cells[j][1].value);
  }
  const auto unit = [](const std::array<Quantity, 3>& of) { return of[0].unit; };
  return heading(stream, "Sensitivities s, angles phi between the axes, offsets O; each +- U") +
         table(cells, {"s, " + unit(result.intrinsic_sensitivity), "phi, " + unit(result.intrinsic_angle),
                       "O, " + unit(result.offset)});
}

/// Outputs beyond those of the protocol, one a line.
std::string further_text(const CalibrationResult& result, std::FILE* stream) {
  std::string text;
  for (const auto& [about, values] : further_outputs(result)) {
    text += heading(stream, fmt::format("{} +- U", about.heading));
    for (const auto& [name, quantity] : values)
      text += block(fmt::format("{} {}", with_expanded(quantity), quantity.unit),
                    fmt::format("  {:<8}", name), std::string(10, ' '));
  }
  return text;
}

std::optional<Budget> budget_of(const AnalysedItem& item) {
  return budget_of_result(item.stored.record, item.results.front());
}

std::string dominating(const Budget& budget, std::FILE* stream) {
  std::string text = heading(stream, "What dominates U (largest part of the variance)");
  for (const DominatingInput& each : dominating_inputs(budget)) {
    std::vector<std::string> outputs;
    for (const auto& [symbol, share] : each.outputs)
      outputs.push_back(fmt::format("{} {:.0f} %", symbol, 100.0 * share));
    text += block(fmt::format("{}: {}", each.input, fmt::join(outputs, ", ")), "  ", "    ");
  }
  return text;
}

std::string full_command(const std::string& file) {
  return fmt::format("abcal analyse {} --full", file);
}

/// The command for one item, where the run has several.
std::string full_command(const AnalysedItem& item, const std::string& file) {
  const bool several = item.stored.header.items.size() > 1;
  return fmt::format("abcal analyse {}{} --full", file,
                     several ? fmt::format(" --item {}", item.stored.item) : "");
}

/// The defaults that cost much, each with the output that it costs most; `whose` says of which item.
/// @param is_least  the fit would choose other weights without the effect: the costs are least values
void add_costly_defaults(const std::vector<std::pair<DefaultCost, std::string>>& costs, bool is_least,
                         std::vector<Warning>& list) {
  Warning warning{
      fmt::format(
          "Sizes of effects that nobody stated are defaults. U would be smaller by{} this part without:",
          is_least ? " at least" : ""),
      "docs/effects.md"};
  for (const auto& [cost, whose] : costs) {
    if (cost.cost > kNotableCost)
      warning.lines.push_back(
          fmt::format("{:>3.0f} % {:<7} {}{}", 100.0 * cost.cost, cost.output, key_of(*cost.size), whose));
  }
  if (!warning.lines.empty()) list.push_back(std::move(warning));
}

/// Empty: the run is complete, or it is a CSV.
std::string incomplete_words(const StoredRun& stored) {
  if (stored.header.plan.empty() || stored.state == RunState::kComplete) return {};
  return fmt::format("This run is {}: {} of {} angles are measured", to_string(stored.state),
                     stored.measured.size(), stored.header.plan.size());
}

void add_incomplete(const StoredRun& stored, const std::string& file, std::vector<Warning>& list) {
  const std::string words = incomplete_words(stored);
  if (words.empty()) return;
  list.push_back(
      {.words = words,
       .leads_to = stored.state == RunState::kAbandoned ? "docs/troubleshooting.md" : "abcal resume " + file,
       .at_first_sight = true});
}

std::vector<Warning> warnings_of(const AnalysedItem& item, const std::optional<Budget>& budget,
                                 const std::string& file) {
  const CalibrationResult& result = item.results.front();
  const EffectSizes& sizes = item.stored.record.tolerances;
  const std::string full = full_command(item, file);
  std::vector<Warning> list;
  add_incomplete(item.stored, file, list);
  if (result.verdict == Verdict::kNotUsable) {
    list.push_back({.words = "No numbers are given, because the result is not usable",
                    .leads_to = "docs/troubleshooting.md",
                    .at_first_sight = true});
  } else if (result.verdict == Verdict::kDoubtful) {
    list.push_back({.words = "The result is doubtful: no certificate can be issued for it",
                    .leads_to = full,
                    .at_first_sight = true});
  }
  if (budget) {
    std::vector<std::pair<DefaultCost, std::string>> costs;
    for (const DefaultCost& each : default_costs(sizes, *budget)) costs.emplace_back(each, "");
    add_costly_defaults(costs, result.joint.has_value(), list);
  }
  for (const Message& note : further_notes(result, sizes)) list.push_back({note, full});
  for (const Message& words : uncovered_effects_words(sizes, Advice::kForOperator))
    list.push_back({words, kKeysCommand});
  return list;
}

/// For all items: the warnings of the run, and each default where it costs most.
std::vector<Warning> warnings_of(const AnalysedRun& run, const std::string& file) {
  const StoredRun& stored = run.items.front().stored;
  std::vector<Warning> list;
  add_incomplete(stored, file, list);
  if (run.joint.stage) {
    for (const Message& words : run.joint.stage->contradicted_sizes)
      list.push_back({words, full_command(file)});
  }
  std::map<std::string_view, std::pair<DefaultCost, std::size_t>> largest;  // by key, with the item from 0
  for (std::size_t k = 0; k < run.items.size(); ++k) {
    const std::optional<Budget> budget =
        budget_of_result(run.items[k].stored.record, run.joint.items[k].result);
    if (!budget) continue;
    for (const DefaultCost& each : default_costs(run.items[k].stored.record.tolerances, *budget)) {
      const auto [known, is_new] = largest.try_emplace(each.size->key, each, k);
      if (!is_new && each.cost > known->second.first.cost) known->second = {each, k};
    }
  }
  std::vector<std::pair<DefaultCost, std::string>> costs;
  for (const auto& [key, most] : largest)
    costs.emplace_back(most.first, fmt::format(" (item {})", most.second + 1));
  std::ranges::stable_sort(costs, std::greater{}, [](const auto& each) { return each.first.cost; });
  add_costly_defaults(costs, true, list);
  for (const Message& words : uncovered_effects_words(stored.record.tolerances, Advice::kForOperator))
    list.push_back({words, kKeysCommand});
  return list;
}

/// Every default with its cost.
std::string defaults_text(const AnalysedItem& item, const Budget& budget, std::FILE* stream) {
  if (!has_angles(item.stored.record)) return {};  // It has no stage.
  const std::string text = default_costs_text(default_costs(item.stored.record.tolerances, budget));
  if (text.empty()) return text;
  return fmt::format(
      "{}{}",
      heading(stream, "Defaults that nobody stated: by how much U would be smaller if the size were zero"),
      text);
}

std::string warnings_text(const std::vector<Warning>& warnings, std::FILE* stream) {
  if (warnings.empty()) return {};
  std::string text = heading(stream, "Warnings");
  for (const Warning& warning : warnings) {
    text += block(warning.words, "  - ", "    ");
    for (const std::string& line : warning.lines) text += "    " + line + "\n";
    text += "    -> " + printable_line(warning.leads_to) + "\n";
  }
  return text;
}

/// The warnings without which the result would mislead; how many others there are, and the command that lists
/// them; what to do next; the file.
/// @param full  the command that lists them
std::string closing_lines(std::vector<Warning> warnings, const std::string& full, const std::string& file,
                          std::FILE* stream) {
  const auto others = std::stable_partition(warnings.begin(), warnings.end(),
                                            [](const Warning& warning) { return warning.at_first_sight; });
  const auto count = warnings.end() - others;
  const bool sound = others == warnings.begin();
  warnings.erase(others, warnings.end());
  std::string text = warnings_text(warnings, stream);
  const auto line = [](const std::string& intro, const std::string& command) {
    return fmt::format("{} {}\n", intro, printable_line(command));
  };
  if (count > 0) text += line(fmt::format("{} {}:", count, count == 1 ? "warning" : "warnings"), full);
  if (sound) text += line("Next:", fmt::format("abcal report {} --html report.html", file));
  return text + line("File:", file);
}

}  // namespace

std::string summary_text(const AnalysedItem& item, const std::string& file, std::FILE* stream) {
  const CalibrationResult& result = item.results.front();
  std::string text = verdict_block(result.verdict, result.estimator + " estimator", result.why, stream) +
                     item_line(item.stored);
  if (result.verdict != Verdict::kNotUsable)
    text += "\n" + intrinsic_table(result, stream) + further_text(result, stream) + "  " + kU + "\n";
  return text +
         closing_lines(warnings_of(item, budget_of(item), file), full_command(item, file), file, stream);
}

std::string summary_text(const AnalysedRun& run, const std::string& file, std::FILE* stream) {
  if (run.items.size() == 1) return summary_text(run.items.front(), file, stream);
  std::string text = verdict_block(
      run.joint.verdict, fmt::format("{} items, joint estimator", run.items.size()), run.joint.why, stream);
  const std::vector<RunItem>& identities = run.items.front().stored.header.items;
  for (std::size_t k = 0; k < run.items.size(); ++k) {
    const AnalysedItem& item = run.items[k];
    const CalibrationResult& result = run.joint.items[k].result;
    text += "\n" + block(fmt::format("Item {}: {}", item_words(identities[k]), verdict_words(result.verdict)),
                         "", "  ");
    if (!run.joint.items[k].in_common_fit)
      text += block("not in the common fit: " + run.joint.items[k].why_not, "  ", "    ");
    const ItemProgress& progress = item.stored.own_progress();
    if (progress.dropped_at)
      text += block(fmt::format("dropped before angle {}: {}", *progress.dropped_at + 1, progress.reason),
                    "  ", "    ");
    if (result.verdict != Verdict::kNotUsable)
      text += intrinsic_table(result, stream) + further_text(result, stream);
    if (result.verdict == Verdict::kDoubtful) text += block(result.why, "  ", "    ");
    text += "  -> " + full_command(item, file) + "\n";
  }
  return text + fmt::format("\n{}\n", kU) +
         closing_lines(warnings_of(run, file), full_command(file), file, stream);
}

std::string full_text(const AnalysedItem& item, const std::string& file, std::FILE* stream) {
  CalibrationResult result = item.results.front();
  // These are among the warnings.
  const std::vector<Message> listed = further_notes(result, item.stored.record.tolerances);
  std::erase_if(result.diagnostics.notes,
                [&](const Message& note) { return std::ranges::find(listed, note) != listed.end(); });
  std::string text = result_text(result, stream);
  const std::optional<Budget> budget = budget_of(item);
  if (budget) text += dominating(*budget, stream) + defaults_text(item, *budget, stream);
  if (item.results.size() > 1)
    text += fmt::format("\n{}\n{}", emphasised(stream, Emphasis::kHeading, "Estimators side by side"),
                        comparison_text(item.results, result.estimator));
  return text + warnings_text(warnings_of(item, budget, file), stream);
}

std::string full_text(const AnalysedRun& run, const std::string& file, std::FILE* stream) {
  if (run.items.size() == 1) return full_text(run.items.front(), file, stream);
  return tray_text(run, stream) + warnings_text(warnings_of(run, file), stream);
}

}  // namespace abcal
