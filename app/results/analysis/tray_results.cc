#include "app/results/analysis/tray_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <stdexcept>

#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_text.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

Json quantity_json(const Quantity& q) {
  return {{"value", json_number(q.value)},
          {"standard_uncertainty", json_number(q.standard_uncertainty)},
          {"unit", q.unit}};
}

template <class Matrix>
Json matrix_json(const Matrix& matrix) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    Json row = Json::array();
    for (Eigen::Index k = 0; k < matrix.cols(); ++k) row.push_back(json_number(matrix(i, k)));
    rows.push_back(std::move(row));
  }
  return rows;
}

Json item_json(const RunItem& identity, const ItemProgress& progress, const TrayItemResult& item) {
  Json json{{"k", identity.k},
            {"maker", identity.maker},
            {"model", identity.model},
            {"serial_number", identity.serial_number},
            {"driver", identity.driver},
            {"port", identity.port},
            {"mounting", identity.mounting},
            {"angles_measured", progress.measured},
            {"in_common_fit", item.in_common_fit},
            {"why_not_in_common_fit", item.in_common_fit ? Json(nullptr) : Json(item.why_not)}};
  json["agreement"] = {{"chi2_given_others", json_number(item.chi2_given_others)},
                       {"degrees_of_freedom", item.degrees_of_freedom},
                       {"probability", json_number(item.probability)}};
  json["result"] = result_json(item.result);
  return json;
}

Json stage_json(const TrayStage& stage) {
  Json unknowns = Json::array();
  for (const StageQuantity& unknown : stage.unknowns) {
    Json json{{"effect", unknown.effect}, {"name", unknown.name}};
    json.update(quantity_json(unknown.value));
    unknowns.push_back(std::move(json));
  }
  Json steps = Json::array();
  for (const StageStep& step : stage.steps) {
    steps.push_back({{"experiment", step.experiment},
                     {"n", step.n},
                     {"role", to_string(step.role)},
                     {"step_error", quantity_json(step.value)},
                     {"angle_error", quantity_json(step.angle_error)}});
  }
  Json effects = Json::array();
  for (const EffectTest& effect : stage.effects) {
    effects.push_back({{"name", effect.name},
                       {"key", effect.key},
                       {"times_stated", json_number(effect.times_stated)},
                       {"degrees_of_freedom", effect.degrees_of_freedom},
                       {"probability", json_number(effect.probability)},
                       {"passed", effect.passed}});
  }
  return {{"items", stage.items},
          {"unknowns", std::move(unknowns)},
          {"angles", std::move(steps)},
          {"effects", std::move(effects)},
          {"contradicted_sizes", stage.contradicted_sizes}};
}

/// Pairs of items of the common fit, each once: i before k, from 0.
std::vector<std::pair<std::size_t, std::size_t>> pairs_of(const TrayResult& tray) {
  std::vector<std::pair<std::size_t, std::size_t>> out;
  for (std::size_t i = 0; i < tray.items.size(); ++i) {
    for (std::size_t k = i + 1; k < tray.items.size(); ++k) {
      if (tray.items[i].in_common_fit && tray.items[k].in_common_fit) out.emplace_back(i, k);
    }
  }
  return out;
}

/// Nothing if the units of the items differ: their difference has no meaning.
std::optional<IntrinsicComparison> difference_of(const TrayResult& tray, std::size_t i, std::size_t k) {
  if (tray.items[i].result.response_unit != tray.items[k].result.response_unit) return std::nullopt;
  return compare_items(tray, i, k);
}

Json difference_json(std::size_t i, std::size_t k, const IntrinsicComparison& comparison) {
  Json properties = Json::array();
  for (std::size_t p = 0; p < comparison.properties.size(); ++p) {
    const PropertyDifference& property = comparison.properties[p];
    properties.push_back({{"name", kIntrinsicSymbols[p]},
                          {"difference", json_number(property.difference)},
                          {"standard_uncertainty", json_number(property.standard_uncertainty)},
                          {"e_n", json_number(property.e_n)}});
  }
  return {{"items", {i + 1, k + 1}},
          {"properties", std::move(properties)},
          {"chi2", json_number(comparison.chi2)},
          {"chi2_probability", json_number(comparison.chi2_probability)}};
}

std::string short_quantity(const Quantity& q) {
  return std::isfinite(q.value) ? value_with_uncertainty(q) : "-";
}

Emphasis emphasis_of(Verdict verdict) {
  if (verdict == Verdict::kUsable) return Emphasis::kGood;
  return verdict == Verdict::kDoubtful ? Emphasis::kWarning : Emphasis::kBad;
}

void add_stage_text(const TrayStage& stage, std::FILE* stream, std::string& text) {
  text += fmt::format("\n{}\n", emphasised(stream, Emphasis::kHeading,
                                           fmt::format("Stage, from the readings of {} items", stage.items)));
  for (const StageQuantity& unknown : stage.unknowns) {
    if (unknown.effect == unknown.name)  // Effects of one unknown; the others are in the JSON.
      text +=
          fmt::format("  {:<8} {:>30} {}\n", unknown.name, short_quantity(unknown.value), unknown.value.unit);
  }
  std::map<int, std::array<double, 3>> of_experiment;  // sum of squares, largest u, count
  for (const StageStep& step : stage.steps) {
    if (!std::isfinite(step.angle_error.value)) continue;
    auto& [squares, u, count] = of_experiment[step.experiment];
    squares += step.angle_error.value * step.angle_error.value;
    u = std::max(u, step.angle_error.standard_uncertainty);
    ++count;
  }
  for (const auto& [experiment, values] : of_experiment)
    text += fmt::format(
        "  angle errors of experiment {}: rms {:.5f} degree over {:.0f} angles; u at most {:.5f} degree\n",
        experiment, std::sqrt(values[0] / values[2]), values[2], values[1]);
  for (const Message& words : stage.contradicted_sizes)
    text += fmt::format("  {}\n", emphasised(stream, Emphasis::kWarning, words));
}

}  // namespace

std::string item_words(const RunItem& item) {
  return fmt::format("{}: {} {}, serial number {}", item.k, item.maker, item.model,
                     item.serial_number.empty() ? "not stated" : item.serial_number);
}

Json tray_json(const AnalysedRun& run) {
  const std::vector<RunItem>& identities = run.items.front().stored.header.items;
  const std::vector<ItemProgress>& progress = run.items.front().stored.items;
  Json items = Json::array();
  Json dropped = Json::array();
  for (std::size_t k = 0; k < identities.size(); ++k) {
    items.push_back(item_json(identities[k], progress.at(k), run.joint.items[k]));
    if (progress[k].dropped_at)
      dropped.push_back({{"k", identities[k].k},
                         {"at_angle", *progress[k].dropped_at + 1},
                         {"angles_measured", progress[k].measured},
                         {"reason", progress[k].reason}});
  }
  Json covariance = Json::array();
  Json differences = Json::array();
  for (const auto& [i, k] : pairs_of(run.joint)) {
    covariance.push_back(
        {{"items", {i + 1, k + 1}}, {"covariance", matrix_json(run.joint.covariance(i, k))}});
    if (const auto difference = difference_of(run.joint, i, k))
      differences.push_back(difference_json(i, k, *difference));
  }
  return {{"schema", "abcal.tray/1"},
          {"verdict", to_string(run.joint.verdict)},
          {"why", run.joint.why},
          {"items", std::move(items)},
          {"dropped", std::move(dropped)},
          {"stage", run.joint.stage ? stage_json(*run.joint.stage) : Json(nullptr)},
          {"covariance_between_items", std::move(covariance)},
          {"differences", std::move(differences)}};
}

std::string tray_text(const AnalysedRun& run, std::FILE* stream) {
  const std::vector<RunItem>& identities = run.items.front().stored.header.items;
  std::string text = fmt::format(
      "{} {} (several items, joint estimator): {}\n\n", emphasised(stream, Emphasis::kHeading, "Result:"),
      emphasised(stream, emphasis_of(run.joint.verdict), verdict_words(run.joint.verdict)), run.joint.why);
  for (std::size_t k = 0; k < identities.size(); ++k) {
    const TrayItemResult& item = run.joint.items[k];
    text +=
        fmt::format("{}  {}{}\n", emphasised(stream, Emphasis::kHeading, "Item " + item_words(identities[k])),
                    emphasised(stream, emphasis_of(item.result.verdict), verdict_words(item.result.verdict)),
                    item.in_common_fit ? "" : "; not in the common fit: " + item.why_not);
    const ItemProgress& progress = run.items.front().stored.items.at(k);
    if (progress.dropped_at)
      text += fmt::format("  dropped before angle {}: {}\n", *progress.dropped_at + 1, progress.reason);
    if (item.result.verdict == Verdict::kNotUsable) continue;  // No numbers without a usable verdict.
    const std::vector<NamedQuantity> all = outputs(item.result);
    for (const NamedQuantity& output : std::span(all).subspan(kOfMatrix))
      text += fmt::format("  {:<8} {:>30} {}\n", output.name, short_quantity(output.quantity),
                          output.quantity.unit);
  }
  if (run.joint.stage) add_stage_text(*run.joint.stage, stream, text);
  const auto pairs = pairs_of(run.joint);
  if (!pairs.empty())
    text += "\nDifferences of intrinsic properties between items (the stage cancels): largest |E_n|\n";
  for (const auto& [i, k] : pairs) {
    if (const auto difference = difference_of(run.joint, i, k))
      text += fmt::format("  items {} and {}: {:.2f}\n", i + 1, k + 1, difference->largest_e_n);
  }
  return text + "\n`abcal analyse RUN --item K` shows one item in full.\n";
}

Json analysis_json(const AnalysedRun& run) {
  return run.items.size() > 1 ? tray_json(run) : result_json(run.items.front().results.front());
}

}  // namespace abcal
