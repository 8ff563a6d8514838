#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "app/studies/calibration/calibration_study.h"

namespace abcal {
namespace {

std::string row_of(std::string_view name, const GroupScores& all, const GroupScores& usable) {
  return fmt::format(
      "  {:<15} {:>9.2e}  {:>6.3f} ({:.3f} to {:.3f})  {:>5.3f} {:>6.4f} {:>6.4f}  {:>6.3f} {:>6.4f}\n", name,
      all.rms_u, all.rms_z, all.low, all.high, all.coverage[0], all.coverage[1], all.coverage[2],
      usable.rms_z, usable.coverage[1]);
}

nlohmann::ordered_json scores_json(const GroupScores& scores) {
  return {{"outputs", scores.count},
          {"rms_uncertainty", scores.rms_u},
          {"rms_z", scores.rms_z},
          {"rms_z_limits", {scores.low, scores.high}},
          {"coverage", scores.coverage},
          {"probability_of_coverage", scores.too_small},
          {"probability_above", scores.above},
          {"probability_below", scores.below}};
}

}  // namespace

std::string calibration_text(const CalibrationStudy& study) {
  std::string text = fmt::format(
      "Calibrations of benches that are drawn from what is stated: {} of each kind, seed {}.\n"
      "u: rms, relative to the sensitivity (phi: degrees). z: score of the error in the distribution of the\n"
      "result; its rms is to be {} to {} (in brackets 95 % limits). Then the share of intervals for 50, "
      "95.45\n"
      "and 99 % that hold the truth; last z and 95.45 % of the usable results alone.\n",
      study.benches, study.seed, kLeastZ, kMostZ);
  for (const KindOutcome& kind : study.kinds) {
    text += fmt::format("\n{}: {}\n", kind.kind.name, kind.kind.words);
    text += "                          u  rms z                   50 %   95.45 % 99 %   usable\n";
    for (std::size_t g = 0; g < kOutputGroups; ++g)
      if (kind.all.at(g).count > 0)
        text += row_of(output_group_names().at(g), kind.all.at(g), kind.usable.at(g));
    text += fmt::format(
        "  called doubtful: {} of {}, without a result {} (99 % bound of the share {:.3f}, at most {})\n",
        kind.doubtful, kind.benches, kind.no_result, kind.doubtful_limit, kMostDoubtful);
    std::vector<std::pair<int, std::string>> reasons;
    for (const auto& [reason, count] : kind.reasons) reasons.emplace_back(-count, reason);
    std::ranges::sort(reasons);
    constexpr std::size_t kShown = 6;
    for (std::size_t i = 0; i < std::min(kShown, reasons.size()); ++i)
      text += fmt::format("    {} by {}\n", -reasons[i].first, reasons[i].second);
    for (const std::string& remark : kind.remarks) text += "  listed: " + remark + "\n";
    for (const std::string& failure : kind.failures) text += "  FAIL: " + failure + "\n";
    if (kind.failures.empty()) text += "  PASS\n";
  }
  if (study.interrupted) text += "\ninterrupted: the kinds above are complete\n";
  text += fmt::format("\n{}\n", study.passed() ? "PASS: every kind keeps the limits" : "FAIL");
  return text;
}

nlohmann::ordered_json calibration_json(const CalibrationStudy& study) {
  nlohmann::ordered_json json{{"schema", "abcal.calibration-study/1"},
                              {"benches", study.benches},
                              {"seed", study.seed},
                              {"interrupted", study.interrupted},
                              {"passed", study.passed()},
                              {"kinds", nlohmann::ordered_json::array()}};
  for (const KindOutcome& kind : study.kinds) {
    nlohmann::ordered_json one{{"kind", kind.kind.name},
                               {"words", kind.kind.words},
                               {"estimator", kind.kind.estimator},
                               {"benches", kind.benches},
                               {"without_result", kind.no_result},
                               {"doubtful", kind.doubtful},
                               {"doubtful_bound", kind.doubtful_limit},
                               {"reasons", kind.reasons},
                               {"failures", kind.failures},
                               {"listed", kind.remarks},
                               {"groups", nlohmann::ordered_json::array()},
                               {"ranks", kind.ranks}};
    for (std::size_t g = 0; g < kOutputGroups; ++g)
      one["groups"].push_back({{"name", output_group_names().at(g)},
                               {"all", scores_json(kind.all.at(g))},
                               {"usable", scores_json(kind.usable.at(g))}});
    json["kinds"].push_back(std::move(one));
  }
  return json;
}

std::string power_text(const PowerStudy& study) {
  std::string text = fmt::format(
      "Runs of which one effect is not as stated: {} benches each, seed {}. Doubtful: share of the runs "
      "that\n"
      "warn. Then the share of intervals for 95.45 % that hold the truth, in the runs that do not.\n\n"
      "  kind       effect                stated      drawn  doubtful",
      study.benches, study.seed);
  for (const std::string& group : output_group_names()) text += fmt::format("  {:>12}", group);
  text += "\n";
  for (const PowerRow& row : study.rows) {
    text += fmt::format("  {:<10} {:<18} {:>9.2g}  {:>9.2g}  {:>8.2f}", row.kind, row.key, row.stated,
                        row.drawn, static_cast<double>(row.doubtful) / row.benches);
    for (const GroupScores& group : row.usable)
      text += group.count == 0 ? fmt::format("  {:>12}", "-") : fmt::format("  {:>12.3f}", group.coverage[1]);
    text += "\n";
  }
  if (study.interrupted) text += "\ninterrupted: the rows above are complete\n";
  return text;
}

nlohmann::ordered_json power_json(const PowerStudy& study) {
  nlohmann::ordered_json json{{"schema", "abcal.power-study/1"},
                              {"benches", study.benches},
                              {"seed", study.seed},
                              {"interrupted", study.interrupted},
                              {"rows", nlohmann::ordered_json::array()}};
  for (const PowerRow& row : study.rows) {
    nlohmann::ordered_json one{{"kind", row.kind},
                               {"effect", row.key},
                               {"stated", row.stated},
                               {"drawn", row.drawn},
                               {"benches", row.benches},
                               {"doubtful", row.doubtful},
                               {"groups", nlohmann::ordered_json::array()}};
    for (std::size_t g = 0; g < kOutputGroups; ++g)
      if (row.usable.at(g).count > 0)
        one["groups"].push_back(
            {{"name", output_group_names().at(g)}, {"usable", scores_json(row.usable.at(g))}});
    json["rows"].push_back(std::move(one));
  }
  return json;
}

}  // namespace abcal
