#include "app/results/analysis/result_json.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "protocol/estimators/checks/check_meanings.h"
#include "protocol/quantities/output_names.h"
#include "protocol/quantities/quantity_groups.h"
#include "protocol/record/message_json.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

Json quantity(const Quantity& q) {
  return {{"value", json_number(q.value)},
          {"standard_uncertainty", json_number(q.standard_uncertainty)},
          {"type_a", json_number(q.type_a)},
          {"type_b", json_number(q.type_b)},
          {"unit", q.unit}};
}

/// An output of the result: with its degrees of freedom (null: infinite) and the factor k of U = k u.
Json output_quantity(const Quantity& q) {
  Json json = quantity(q);
  json["degrees_of_freedom"] = json_number(q.degrees_of_freedom);
  json["coverage_factor"] =
      std::isfinite(q.standard_uncertainty) ? json_number(coverage_factor(q)) : Json(nullptr);
  return json;
}

template <class Range>
Json quantities(const Range& range) {
  Json list = Json::array();
  for (const Quantity& q : range) list.push_back(quantity(q));
  return list;
}

template <class Range>
Json output_quantities(const Range& range) {
  Json list = Json::array();
  for (const Quantity& q : range) list.push_back(output_quantity(q));
  return list;
}

Json responses_json(const MotionResult& motion) {
  Json list = Json::array();
  for (const RateResponse& response : motion.responses)
    list.push_back({{"rate_deg_per_s", response.rate_deg_per_s},
                    {"frequency_hz", response.frequency_hz},
                    {"amplitude", quantities(response.amplitude)},
                    {"phase_beyond_delay", quantity(response.phase)}});
  return list;
}

/// The values of a group in its shape. Outputs have their coverage factor.
Json group_json(const FoundGroup& group) {
  Json list = Json::array();
  for (std::size_t i = 0; i < group.values.size(); ++i) {
    const Quantity& q = group.values[i].quantity;
    Json value = group.about.kind == QuantityKind::kOutput ? output_quantity(q) : quantity(q);
    if (group.about.columns == 0) return value;
    if (group.about.columns > 1 && i % group.about.columns == 0) list.push_back(Json::array());
    (group.about.columns > 1 ? list.back() : list).push_back(std::move(value));
  }
  return list;
}

/// Sets the values of groups; outputs that are not among them become null.
void set_groups(Json& json, const std::vector<FoundGroup>& groups) {
  for (const QuantityGroup& group : quantity_groups())
    if (group.kind == QuantityKind::kOutput) json[Json::json_pointer(group.path())] = nullptr;
  for (const FoundGroup& group : groups) json[Json::json_pointer(group.about.path())] = group_json(group);
}

/// The description of groups for programs that show them: names, meaning, and the place of the values.
Json descriptions_json(const std::vector<FoundGroup>& groups) {
  Json list = Json::array();
  for (const auto& [about, values] : groups)
    list.push_back({{"key", about.key},
                    {"path", about.path()},
                    {"kind", to_string(about.kind)},
                    {"of_protocol", about.of_protocol},
                    {"frame", to_string(about.frame)},
                    {"heading", about.heading},
                    {"meaning", about.meaning},
                    {"symbols", about.symbols}});
  return list;
}

template <class Matrix>
Json matrix(const std::optional<Matrix>& m) {
  if (!m) return nullptr;
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < m->rows(); ++i) {
    Json row = Json::array();
    for (Eigen::Index j = 0; j < m->cols(); ++j) row.push_back(json_number((*m)(i, j)));
    rows.push_back(std::move(row));
  }
  return rows;
}

Json stage_record_use_json(const StageRecordUse& use) {
  Json tests = Json::array();
  for (const EffectTest& test : use.tests)
    tests.push_back({{"part", test.name},
                     {"times_expected", json_number(test.times_stated)},
                     {"chi2", json_number(test.chi2)},
                     {"degrees_of_freedom", test.degrees_of_freedom},
                     {"probability", json_number(test.probability)},
                     {"passed", test.passed}});
  return {{"stage", use.stage},   {"sha256", use.sha256},         {"learned_utc", use.learned_utc},
          {"runs", use.runs},     {"age_months", use.age_months}, {"validity_months", use.validity_months},
          {"agrees", use.agrees}, {"tests", std::move(tests)}};
}

Json diagnostics(const Diagnostics& d) {
  Json fits = Json::array();
  for (const FitDiagnostic& fit : d.fits) {
    Json harmonics = Json::array();
    for (const Harmonic& harmonic : fit.harmonics) {
      harmonics.push_back({{"order", harmonic.order},
                           {"sin", quantity(harmonic.sin_amplitude)},
                           {"cos", quantity(harmonic.cos_amplitude)}});
    }
    fits.push_back({{"experiment", fit.experiment},
                    {"accelerometer", kOutputNames.at(static_cast<std::size_t>(fit.accelerometer))},
                    {"sine", quantity(fit.sine)},
                    {"cosine", quantity(fit.cosine)},
                    {"constant", quantity(fit.constant)},
                    {"angles", fit.angles},
                    {"degrees_of_freedom", fit.degrees_of_freedom},
                    {"residual_rms", json_number(fit.residual_rms)},
                    {"chi2", json_number(fit.chi2)},
                    {"harmonics", std::move(harmonics)},
                    {"harmonics_residual_rms", json_number(fit.harmonics_residual_rms)}});
  }
  Json closures = Json::array();
  for (const Closure& closure : d.closures) {
    closures.push_back({{"name", closure.name},
                        {"accelerometer", kOutputNames.at(static_cast<std::size_t>(closure.accelerometer))},
                        {"value", quantity(closure.value)}});
  }
  Json closing = Json::array();
  for (const ClosingDifference& difference : d.closing_differences) {
    closing.push_back({{"experiment", difference.experiment},
                       {"accelerometer", kOutputNames.at(static_cast<std::size_t>(difference.accelerometer))},
                       {"value", quantity(difference.value)}});
  }
  Json flags = Json::array();
  Json checks = Json::array();
  for (const Check& check : d.checks) {
    checks.push_back({{"check", check.name},
                      {"passed", check.passed},
                      {"found", json_number(check.found)},
                      {"limit", json_number(check.limit)},
                      {"unit", check.unit},
                      {"words", check.words}});
  }
  for (const FlagCount& flag : d.flags) flags.push_back({{"flag", flag.flag}, {"dwells", flag.dwells}});
  return {{"fits", std::move(fits)},
          {"closures", std::move(closures)},
          {"closing_differences", std::move(closing)},
          {"chi2", json_number(d.chi2)},
          {"degrees_of_freedom", d.degrees_of_freedom},
          {"chi2_probability", json_number(d.chi2_probability)},
          {"low_chi2_probability", json_number(d.low_chi2_probability)},
          {"sizes_too_large", json_number(d.sizes_too_large)},
          {"reciprocal_condition", json_number(d.reciprocal_condition)},
          {"rank", d.rank},
          {"angles_used", d.angles_used},
          {"angles_flagged", d.angles_flagged},
          {"flags", std::move(flags)},
          {"checks", std::move(checks)},
          {"notes", d.notes}};
}

/// K0 to K3 at zero along each output's own axis. It is not the measurand.
Json model_equation_json(const ModelEquation& equation) {
  Json list = Json::array();
  for (std::size_t j = 0; j < 3; ++j) {
    list.push_back({{"output", kOutputNames[j]},
                    {"k", quantities(equation.k[j])},
                    {"covariance", matrix(std::optional(equation.covariance[j]))}});
  }
  return list;
}

Json effects_json(const std::vector<EffectTest>& effects) {
  Json list = Json::array();
  for (const EffectTest& effect : effects) {
    list.push_back({{"name", effect.name},
                    {"key", effect.key},
                    {"times_stated", effect.stated_zero ? Json(nullptr) : json_number(effect.times_stated)},
                    {"degrees_of_freedom", effect.degrees_of_freedom},
                    {"probability", json_number(effect.probability)},
                    {"passed", effect.passed}});
  }
  return list;
}

/// The numbers of the paper's own formula, for comparison with other laboratories' ABC results.
Json published_json(const PublishedResult& published) {
  Json json;
  json["formula"] = "Geist & Gaitan 2021, Eqs. 5 to 10, not corrected for k2 and k3";
  json["type_b_effects"] = {"alignment_deg", "initial_turn_deg", "zero_deg", "step_deg"};
  set_groups(json, found_groups(as_result(published), QuantityKind::kOutput));
  json["covariance"] = matrix(std::optional(published.covariance));
  json["covariance_intrinsic"] = matrix(std::optional(published.covariance_intrinsic));
  return json;
}

Json line_json(const LineResult& line) {
  Json rows = Json::array();
  for (const auto& row : line.sensitivity_matrix) rows.push_back(output_quantities(row));
  return {{"sensitivity_matrix", std::move(rows)}, {"offset", output_quantities(line.offset)}};
}

/// All messages whose English texts the result has.
std::vector<Message> messages_of(const CalibrationResult& result) {
  std::vector<Message> all{result.why};
  const auto add = [&all](const auto& list, auto member) {
    for (const auto& each : list) all.push_back(each.*member);
  };
  add(result.diagnostics.checks, &Check::words);
  for (const Check& check : result.diagnostics.checks) all.push_back(name_of_check(check.name));
  all.insert(all.end(), result.diagnostics.notes.begin(), result.diagnostics.notes.end());
  all.insert(all.end(), result.unstated_effects.begin(), result.unstated_effects.end());
  if (result.stage_record) add(result.stage_record->tests, &EffectTest::name);
  if (result.joint) add(result.joint->effects, &EffectTest::name);
  if (result.norm) all.push_back(result.norm->coverage_words);
  return all;
}

}  // namespace

nlohmann::ordered_json json_number(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? Json(*value) : Json(nullptr);
}

Json result_json(const CalibrationResult& result) {
  Json json;
  json["schema"] = "abcal.result/1";
  json["estimator"] = result.estimator;
  json["verdict"] = to_string(result.verdict);
  json["why"] = result.why;
  json["source"] = result.source;
  json["response_unit"] = result.response_unit;
  json["g_loc"] = quantity(result.g_loc);
  json["g_loc"]["source"] = result.g_loc_source;
  const std::vector<FoundGroup> groups = found_groups(result);
  set_groups(json, groups);
  json["quantities"] = descriptions_json(groups);
  json["covariance"] = matrix(result.covariance);
  json["covariance_intrinsic"] = matrix(result.covariance_intrinsic);
  json["diagnostics"] = diagnostics(result.diagnostics);
  json["default_effects"] = result.unstated_effects;
  if (result.faces) {
    for (std::size_t k = 0; k < result.faces->face.size(); ++k) {
      json["faces"].push_back(line_json(result.faces->face[k]));
      json["faces"].back()["face"] = k + 1;
    }
    json["face_difference"] = line_json(result.faces->difference);
  }
  if (result.stage_record) json["stage_record"] = stage_record_use_json(*result.stage_record);
  for (const SeriesMember& member : result.series) {
    Json alone;
    for (const Apart& each : member.alone)
      alone[each.estimator] = {{"largest_difference_in_u", each.in_u}, {"output", each.output}};
    json["series"].push_back({{"source", member.source},
                              {"mounting", member.mounting},
                              {"small_turn_degree", member.small_turn_deg},
                              {"verdict_alone", to_string(member.verdict)},
                              {"alone", std::move(alone)}});
  }
  if (result.published) json["published"] = published_json(*result.published);
  if (result.model_equation) json["model_equation"] = model_equation_json(*result.model_equation);
  if (result.joint) {
    const JointResult& joint = *result.joint;
    json["step_error"] = Json::array();
    for (const auto& experiment : joint.step_error) json["step_error"].push_back(quantities(experiment));
    json["nonlinearity"]["fitted"] = joint.nonlinearity_fitted;
    if (joint.motion) json["motion"]["responses"] = responses_json(*joint.motion);
    const NormAgreement& test = joint.norm_against_joint;
    json["norm_against_joint"] = {{"statistic", test.done ? json_number(test.statistic) : Json(nullptr)},
                                  {"degrees_of_freedom", test.degrees_of_freedom},
                                  {"probability", test.done ? json_number(test.probability) : Json(nullptr)}};
    json["effects"] = effects_json(joint.effects);
    json["iterations"] = joint.iterations;
  }
  if (result.norm) {
    const NormResult& norm = *result.norm;
    json["poses"] = norm.poses;
    json["poses_left_out"] = norm.poses_left_out;
    json["left_out"] = Json::array();
    for (const auto& [pose, residual] : norm.left_out)
      json["left_out"].push_back({{"pose", pose}, {"residual", json_number(residual)}});
    json["norm_rms"] = json_number(norm.norm_rms);
    if (norm.direction_rms_deg) json["direction_rms_deg"] = json_number(*norm.direction_rms_deg);
    json["sphere_coverage"] = json_number(norm.sphere_coverage);
    json["coverage_words"] = norm.coverage_words;
  }
  json["messages"] = messages_json(messages_of(result));
  return json;
}

Json json_of_items(std::vector<Json> items) {
  if (items.size() == 1) return std::move(items.front());
  Json json;
  json["schema"] = items.front().at("schema");
  json["items"] = std::move(items);
  return json;
}

}  // namespace abcal
