#include "app/studies/stage_records/stage_record_text.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace abcal {

std::string stage_record_text(const StageRecordStudy& study) {
  std::string text = fmt::format(
      "Faces, mountings and stage records: {} simulated stages of each experiment, seed {}. Noise of a mean "
      "1e-5.\nu: rms of the stated standard uncertainty (figure of the design); z: rms of error / u; 95 %: "
      "coverage.\n\n",
      study.stages, study.seed);
  for (const StageExperimentOutcome& outcome : study.outcomes) {
    text += outcome.words;
    if (outcome.failed > 0) text += fmt::format("; {} without a solution", outcome.failed);
    text += "\n";
    for (std::size_t g = 0; g < kStageGroups; ++g) {
      const ErrorGroup& group = outcome.groups[g];
      if (!(group.rms_u > 0.0)) continue;
      const std::string limit = group.limit > 0.0 ? fmt::format("({:.1e})", group.limit) : "";
      text +=
          fmt::format("  {:<10} u {:.2e} {:<10} z {:.3f}  95 % {:.3f}  largest z {:.1f}\n",
                      stage_group_names()[g], group.rms_u, limit, group.rms_z, group.coverage, group.most_z);
    }
  }
  const auto share = [&](std::string_view words, int of, int all) {
    text += fmt::format("  {:<44} {} of {} ({:.1f} %)\n", words, of, all, all > 0 ? 100.0 * of / all : 0.0);
  };
  text += "The test of a record contradicts it\n";
  share("in sound runs (1 % are allowed)", study.alarms.sound_contradicted, study.alarms.sound);
  share("after a knock (95 % are required)", study.alarms.knocked_contradicted, study.alarms.knocked);
  share("on another stage", study.alarms.other_contradicted, study.alarms.other);
  const auto list = [&](std::string_view none, std::string_view some, const std::vector<std::string>& words) {
    text += fmt::format("\n{}\n", words.empty() ? none : some);
    for (const std::string& each : words) text += fmt::format("  {}\n", each);
  };
  list("Every uncertainty reaches the figure of the design.",
       "Larger than the figure of the design:", study.missed());
  list("No group contradicts its uncertainties (5 % for all groups together, Holm).",
       "Groups that contradict their uncertainties (5 % for all together, Holm):", study.contradictions());
  if (study.interrupted) text += "\ninterrupted: the stages above are complete\n";
  return text;
}

nlohmann::ordered_json stage_record_json(const StageRecordStudy& study) {
  nlohmann::ordered_json json{{"schema", "abcal.stage-records/1"},
                              {"stages", study.stages},
                              {"seed", study.seed},
                              {"interrupted", study.interrupted},
                              {"experiments", nlohmann::ordered_json::array()}};
  for (const StageExperimentOutcome& outcome : study.outcomes) {
    nlohmann::ordered_json one{{"experiment", outcome.words},
                               {"failed", outcome.failed},
                               {"groups", nlohmann::ordered_json::array()}};
    for (std::size_t g = 0; g < kStageGroups; ++g) {
      const ErrorGroup& group = outcome.groups[g];
      if (!(group.rms_u > 0.0)) continue;
      const std::string_view name = stage_group_names()[g];
      one["groups"].push_back(error_group_json(name, name == "phi" ? "degree" : "1", group));
    }
    json["experiments"].push_back(std::move(one));
  }
  const auto alarms = [](int runs, int contradicted) {
    return nlohmann::ordered_json{{"runs", runs}, {"contradicted", contradicted}};
  };
  json["alarms"] = {{"sound", alarms(study.alarms.sound, study.alarms.sound_contradicted)},
                    {"knocked", alarms(study.alarms.knocked, study.alarms.knocked_contradicted)},
                    {"other_stage", alarms(study.alarms.other, study.alarms.other_contradicted)}};
  json["missed"] = study.missed();
  json["contradictions"] = study.contradictions();
  return json;
}

}  // namespace abcal
