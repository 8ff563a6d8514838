#include "app/results/analysis/budget_words.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace abcal {
namespace {

/// From here on the coverage factor is that of infinitely many, to all its digits.
constexpr double kManyDegrees = 1000.0;

}  // namespace

std::string degrees_words(const BudgetLine& line, const std::vector<int>& outputs) {
  double least = std::numeric_limits<double>::infinity(), most = 0.0;
  for (const int k : outputs) {
    if (!(line.contribution(k) > 0.0)) continue;
    least = std::min(least, line.degrees_of_freedom(k));
    most = std::max(most, line.degrees_of_freedom(k));
  }
  if (!(least < kManyDegrees)) return {};
  const std::string from = fmt::format("{:.0f}", std::floor(least));
  if (!(most < kManyDegrees)) return fmt::format("{} or more", from);
  const std::string to = fmt::format("{:.0f}", std::floor(most));
  return from == to ? from : fmt::format("{} to {}", from, to);
}

std::vector<std::pair<std::string, std::string>> budget_sources(const Budget& budget) {
  std::vector<std::pair<std::string, std::vector<std::string>>> inputs;
  for (const BudgetLine& line : budget.lines) {
    auto found = std::find_if(inputs.begin(), inputs.end(),
                              [&](const auto& known) { return known.first == line.source; });
    if (found == inputs.end()) found = inputs.insert(inputs.end(), {line.source, {}});
    std::vector<std::string>& names = found->second;
    const std::string name = line.key.empty() ? line.input.english() : line.key;
    if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  }
  std::vector<std::pair<std::string, std::string>> out;
  for (const auto& [source, names] : inputs) {
    std::string joined;
    for (const std::string& name : names) joined += (joined.empty() ? "" : ", ") + name;
    out.emplace_back(source == "default"  ? "default, which nobody stated"
                     : source.empty()     ? "stated without a source"
                     : source == kThisRun ? "the readings of this run"
                                          : source,
                     std::move(joined));
  }
  return out;
}

std::string gravity_words(const Budget& budget, int output, const std::string& response_unit) {
  for (const BudgetLine& line : budget.lines) {
    if (!(line.contribution_per_mps2(output) > 0.0) || line.contribution(output) > 0.0) continue;
    return fmt::format(
        "{} per m/s2: u = {:.1e} {}/(m/s2), with {:.1f} % of its variance from g_loc (u = {:.1e} m/s2); "
        "per standard g it is 9.80665 times as large, with the same shares.",
        output_symbol(output), budget.combined_per_mps2(output), response_unit,
        100.0 * budget.share_per_mps2(line, output), line.standard_uncertainty);
  }
  return {};
}

std::optional<Budget> budget_of_result(const RunRecord& record, const CalibrationResult& result) {
  if (result.verdict == Verdict::kNotUsable || !result.sensitivity_matrix) return std::nullopt;
  return make_budget(record, result);
}

std::vector<DominatingInput> dominating_inputs(const Budget& budget) {
  std::vector<DominatingInput> inputs;
  std::vector<const BudgetLine*> lines;
  for (const int k : worst_of_each_kind(budget.combined)) {
    const auto largest = std::ranges::max_element(
        budget.lines, {}, [&](const BudgetLine& line) { return budget.share(line, k); });
    if (largest == budget.lines.end()) continue;
    const auto known = static_cast<std::size_t>(std::ranges::find(lines, &*largest) - lines.begin());
    if (known == lines.size()) {
      lines.push_back(&*largest);
      inputs.push_back({largest->input, {}});
    }
    inputs[known].outputs.emplace_back(output_symbol(k), budget.share(*largest, k));
  }
  return inputs;
}

}  // namespace abcal
