#include "app/studies/trials/study_json.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/results/analysis/result_json.h"
#include "drivers/text/names.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

// The four groups, each element made by `element(k)`.
template <class Element>
Json groups(const Element& element) {
  Json json;
  Json rows = Json::array();
  for (int j = 0; j < 3; ++j) rows.push_back({element(3 * j), element(3 * j + 1), element(3 * j + 2)});
  json["sensitivity_matrix"] = std::move(rows);
  const auto triple = [&](int first) {
    return Json::array({element(first), element(first + 1), element(first + 2)});
  };
  json["offset"] = triple(kFirstOffset);
  json["intrinsic_sensitivity"] = triple(kFirstIntrinsicSensitivity);
  json["intrinsic_angle"] = triple(kFirstIntrinsicAngle);
  return json;
}

Json groups(const OutputVector& values) {
  return groups([&](int k) { return json_number(values(k)); });
}

Json groups(const StudyOutput& output) {
  return groups(to_vector(output));
}

template <class Matrix>
Json matrix(const Matrix& m) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < m.rows(); ++i) {
    Json row = Json::array();
    for (Eigen::Index j = 0; j < m.cols(); ++j) row.push_back(json_number(m(i, j)));
    rows.push_back(std::move(row));
  }
  return rows;
}

constexpr auto kMethods = names<IntervalMethod>({{IntervalMethod::kNone, "none"},
                                                 {IntervalMethod::kExact, "exact"},
                                                 {IntervalMethod::kHistogram, "histogram"}});

void add_monte_carlo(Json& json, const MonteCarloResult& result) {
  json["trials"] = result.trials;
  json["interrupted"] = result.interrupted;
  json["adaptive"] = result.adaptive;
  json["converged"] = result.converged;
  json["mean"] = groups(OutputVector(result.mean));
  json["standard_deviation"] = groups(OutputVector(result.standard_deviation));
  json["coverage_probability"] = result.coverage_probability;
  json["interval_method"] = kMethods.of(result.interval_method, "none");
  if (result.coverage.empty()) {
    json["coverage_interval"] = nullptr;
    json["shortest_coverage_interval"] = nullptr;
  } else {
    const auto pair = [](const CoverageInterval& interval) {
      return Json::array({json_number(interval.low), json_number(interval.high)});
    };
    json["coverage_interval"] =
        groups([&](int k) { return pair(result.coverage[static_cast<std::size_t>(k)].symmetric); });
    json["shortest_coverage_interval"] =
        groups([&](int k) { return pair(result.coverage[static_cast<std::size_t>(k)].shortest); });
  }
  json["covariance"] = matrix(result.covariance);
}

std::string join(const std::string& a, const std::string& b) {
  return a.empty() || b.empty() ? a + b : a + " " + b;
}

Json output_order() {
  Json order = Json::array();
  for (int k = 0; k < kStudyOutputs; ++k) order.push_back(output_symbol(k));
  return order;
}

Json budget_json(const Budget& budget) {
  Json lines = Json::array();
  for (const BudgetLine& line : budget.lines) {
    lines.push_back(
        {{"input", line.input},
         {"value", line.value},
         {"unit", line.unit},
         {"distribution", line.distribution},
         {"type", line.type_a ? "A" : "B"},
         {"key", line.key.empty() ? Json(nullptr) : Json(line.key)},
         {"source", line.source},
         {"standard_uncertainty", json_number(line.standard_uncertainty)},
         {"degrees_of_freedom", groups(line.degrees_of_freedom)},
         {"sensitivity", groups(line.sensitivity)},
         {"contribution", groups(line.contribution)},
         {"share", groups([&](int k) { return json_number(budget.share(line, k)); })},
         {"contribution_per_mps2", groups(line.contribution_per_mps2)},
         {"share_per_mps2", groups([&](int k) { return json_number(budget.share_per_mps2(line, k)); })}});
  }
  return {{"lines", std::move(lines)},
          {"combined", groups(budget.combined)},
          {"combined_per_mps2", groups(budget.combined_per_mps2)},
          {"not_covered", budget.not_covered},
          {"notes", budget.notes}};
}

Json validation_json(const std::vector<GumValidation>& validation) {
  if (validation.empty()) return nullptr;
  const auto of = [&](auto member) {
    return groups([&](int k) { return Json(validation[static_cast<std::size_t>(k)].*member); });
  };
  return {{"validated", of(&GumValidation::validated)},
          {"decided", of(&GumValidation::decided)},
          {"expanded_uncertainty", of(&GumValidation::expanded_uncertainty)},
          {"d_low", of(&GumValidation::d_low)},
          {"d_high", of(&GumValidation::d_high)},
          {"tolerance", of(&GumValidation::tolerance)}};
}

/// The statements of the joint result, and how Monte Carlo compares.
void add_joint(Json& json, const RunUncertainty& study) {
  const JointComparison& joint = *study.joint;
  json["posterior"] = {{"standard_uncertainty", groups(joint.standard_uncertainty)},
                       {"coverage_probability", kCoverageProbability},
                       {"expanded_uncertainty", groups(joint.expanded)}};
  if (study.combined.coverage.empty()) {
    json["interval"] = nullptr;
  } else {
    const OutputVector value = to_vector(study.value);
    json["interval"] = groups([&](int k) {
      const CoverageInterval& error = study.combined.coverage[static_cast<std::size_t>(k)].symmetric;
      return Json::array({json_number(value(k) - error.high), json_number(value(k) - error.low)});
    });
  }
  json["differences"] = Json::array();
  for (const StudyDifference& one : joint.differences)
    json["differences"].push_back({{"output", output_symbol(one.output)},
                                   {"of", one.of},
                                   {"monte_carlo", json_number(one.monte_carlo)},
                                   {"stated", json_number(one.stated)}});
  json["solved_in_full"] = {{"trials", joint.solved_in_full},
                            {"not_converged", joint.not_converged},
                            {"rms_deviation_in_u", json_number(joint.largest_deviation)}};
}

}  // namespace

nlohmann::ordered_json study_json(const StudyResult& study) {
  Json json;
  json["schema"] = "abcal.study/1";
  json["set"] = study.set;
  json["title"] = study.title;
  json["trials"] = study.trials;
  json["seed"] = study.seed;
  json["generator"] = "Philox4x32-10";
  json["interrupted"] = study.interrupted;
  json["order"] = output_order();
  json["cases"] = Json::array();
  for (const StudyCase& one : study.cases) {
    Json item;
    item["name"] = one.name;
    std::string note = one.note;
    if (one.error) {
      item["error"] = groups(*one.error);
      if (one.truth) item["truth"] = groups(*one.truth);
    }
    if (one.monte_carlo) {
      item["quantity"] = "error";
      add_monte_carlo(item, *one.monte_carlo);
      note = join(note, one.monte_carlo->note);
      if (one.means_not_zero) {
        item["means_not_zero"] = {{"sensitivity_matrix", (*one.means_not_zero)[0]},
                                  {"intrinsic_properties", (*one.means_not_zero)[1]}};
      }
    }
    if (one.largest_higher_harmonic)
      item["largest_higher_harmonic"] = json_number(*one.largest_higher_harmonic);
    if (!one.table.empty()) item["table"] = one.table;
    if (one.published_truth) {
      item["paper"] = {{"truth", groups(*one.published_truth)}};
    } else if (one.published && one.published_standard_deviation) {
      item["paper"] = {{"mean", groups(*one.published)},
                       {"standard_deviation", groups(*one.published_standard_deviation)}};
    } else if (one.published) {
      item["paper"] = groups(*one.published);
    }
    if (!note.empty()) item["note"] = note;
    json["cases"].push_back(std::move(item));
  }
  return json;
}

nlohmann::ordered_json study_json(const RunUncertainty& study) {
  Json json;
  json["schema"] = "abcal.study/1";
  json["set"] = "uncertainty";
  json["source"] = study.source;
  json["estimator"] = study.estimator;
  json["trials"] = study.combined.trials;
  json["seed"] = study.seed;
  json["generator"] = "Philox4x32-10";
  json["interrupted"] = study.interrupted;
  json["response_unit"] = study.response_unit;
  json["tolerances"] = {{"alignment_deg", study.tolerances.alignment.deg()},
                        {"step_deg", study.tolerances.step.deg()},
                        {"initial_turn_deg", study.tolerances.initial_turn.deg()},
                        {"zero_deg", study.tolerances.zero.deg()},
                        {"drift", study.tolerances.drift}};
  json["order"] = output_order();
  json["value"] = groups(study.value);
  json["standard_uncertainty"] = groups(study.standard_uncertainty);

  const auto add_case = [&](const char* name, const char* quantity, const MonteCarloResult& result,
                            const std::string& note) {
    Json item;
    item["name"] = fmt::format("{}: {}", study.estimator, name);
    item["quantity"] = quantity;
    add_monte_carlo(item, result);
    const std::string whole = join(note, result.note);
    if (!whole.empty()) item["note"] = whole;
    json["cases"].push_back(std::move(item));
  };
  json["cases"] = Json::array();
  if (study.joint) {
    if (study.no_trials.empty()) add_case("whole estimator", "error", study.combined, kWhatIsChecked);
    add_joint(json, study);
  } else {
    add_case("type B, calibration system", "error", study.type_b, "");
    add_case("type A, paper, section 6", "value", study.type_a,
             study.acs_measured.empty()
                 ? "Nothing measured: means of zero, the stated sizes as standard deviations."
                 : fmt::format("Errors of the stage by its record, SHA-256 {}.", study.acs_measured));
    add_case("combined, whole budget", "error", study.combined, "");
  }
  if (!study.no_trials.empty()) json["no_trials"] = study.no_trials;
  json["budget"] = budget_json(study.budget);
  json["gum_validation"] = validation_json(study.validation);
  json["warnings"] = study.warnings;
  if (study.paper_preset) {
    json["preset"] = {
        {"name", "paper"}, {"standard_uncertainty", groups(study.bounds)}, {"warnings", study.warnings}};
  }
  return json;
}

}  // namespace abcal
