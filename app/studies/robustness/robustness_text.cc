#include "app/studies/robustness/robustness_text.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <string>

#include "protocol/uncertainty/study_output.h"

namespace abcal {
namespace {

std::string cell_of(const GroupCoverage& group) {
  if (!std::isfinite(group.coverage)) return fmt::format("{:>13}", "-");
  return fmt::format("{:>5.2f}{} {:>6.2f}", group.coverage, group.coverage < kLeastCoverage ? '!' : ' ',
                     group.ratio());
}

nlohmann::ordered_json number_or_null(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
}

}  // namespace

std::string robustness_text(const RobustnessStudy& study) {
  std::string text = fmt::format(
      "Robustness: {} simulated benches of each scenario, seed {}. Of runs called usable: coverage of the 95 "
      "% intervals, rms error / u.\n\n{:<22} {:<7} {:<6} {:>6}",
      study.benches, study.seed, "scenario", "kind", "", "usable");
  for (const std::string& name : output_group_names()) text += fmt::format("  {:>14}", name);
  text += "\n";
  int groups = 0;
  int short_groups = 0;
  int short_verdicts = 0;
  for (const ScenarioOutcome& o : study.outcomes) {
    text += fmt::format("{:<22} {:<7} {:<6} {:>6.2f}", o.scenario, to_string(o.kind), o.estimator,
                        o.usable_share());
    for (const GroupCoverage& group : o.groups) {
      text += fmt::format("  {:>14}", cell_of(group));
    }
    text += "\n";
    const std::vector<std::string> shortfalls = o.shortfalls();
    int verdicts = 0;
    for (const std::string& one : shortfalls) verdicts += one.starts_with("usable") ? 1 : 0;
    groups += static_cast<int>(kOutputGroups);
    short_verdicts += verdicts;
    short_groups += static_cast<int>(shortfalls.size()) - verdicts;
  }
  text += fmt::format(
      "\n{} of {} groups below {:.2f} (nominal 0.95); {} of {} verdicts wrong: within the stated sizes at "
      "least {:.2f} are to be usable, far beyond them at most {:.2f}\n",
      short_groups, groups, kLeastCoverage, short_verdicts, study.outcomes.size(), kLeastUsable,
      kMostUsableWhenWrong);
  for (const ScenarioOutcome& o : study.outcomes) {
    const std::vector<std::string> shortfalls = o.shortfalls();
    if (!shortfalls.empty())
      text +=
          fmt::format("  {} ({}), {}: {}\n", o.scenario, o.words, o.estimator, fmt::join(shortfalls, "; "));
  }
  if (study.interrupted) text += "interrupted: the scenarios above are complete\n";
  return text;
}

nlohmann::ordered_json robustness_json(const RobustnessStudy& study) {
  nlohmann::ordered_json json{{"schema", "abcal.robustness/1"},
                              {"benches", study.benches},
                              {"seed", study.seed},
                              {"interrupted", study.interrupted},
                              {"outcomes", nlohmann::ordered_json::array()}};
  for (const ScenarioOutcome& o : study.outcomes) {
    nlohmann::ordered_json one{{"scenario", o.scenario},
                               {"words", o.words},
                               {"kind", to_string(o.kind)},
                               {"estimator", o.estimator},
                               {"runs", o.runs},
                               {"usable", o.usable},
                               {"doubtful", o.doubtful},
                               {"not_usable", o.not_usable},
                               {"groups", nlohmann::ordered_json::array()}};
    for (std::size_t g = 0; g < kOutputGroups; ++g) {
      one["groups"].push_back({{"name", output_group_names()[g]},
                               {"coverage", number_or_null(o.groups[g].coverage)},
                               {"rms_error", number_or_null(o.groups[g].rms_error)},
                               {"rms_uncertainty", number_or_null(o.groups[g].rms_u)},
                               {"ratio", number_or_null(o.groups[g].ratio())}});
    }
    one["rms_uncertainty_of_outputs"] = nlohmann::ordered_json::object();
    for (std::size_t i = 0; i < o.rms_u_of_output.size(); ++i)
      one["rms_uncertainty_of_outputs"][std::string(output_symbol(static_cast<int>(i)))] =
          o.rms_u_of_output[i];
    one["shortfalls"] = o.shortfalls();
    json["outcomes"].push_back(std::move(one));
  }
  return json;
}

}  // namespace abcal
