#include "app/laboratory/certificate/dcc_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <functional>
#include <span>

#include "app/formats/dsi_unit.h"
#include "app/laboratory/certificate/dcc_budget.h"
#include "app/laboratory/certificate/dcc_conditions.h"
#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_rates.h"
#include "app/laboratory/certificate/dcc_state.h"
#include "app/laboratory/certificate/dcc_temperature.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/measurand.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/quantities/quantity_groups.h"

namespace abcal {
namespace {

using Triple = std::array<Quantity, 3>;

std::vector<std::string> labels(const std::string& symbol, const std::array<const char*, 3>& of) {
  std::vector<std::string> list;
  for (const char* one : of) list.push_back(symbol + "_" + one);
  return list;
}

std::vector<std::string> row_labels(const std::string& symbol, std::size_t row) {
  std::vector<std::string> list;
  for (const char* axis : kPlatterAxes) list.push_back(symbol + "_" + kOutputNames[row] + axis);
  return list;
}

void add_rows(XmlElement& data, const Words& words, const std::function<ValueList(std::size_t)>& row) {
  XmlElement list = data.add("dcc:list");
  list.attribute("refType", "abc_matrix3x3");
  for (std::size_t j = 0; j < 3; ++j)
    add_list(list, words, words("row of accelerometer {accelerometer}", kOutputNames[j]), row(j));
}

std::vector<Quantity> as_vector(const Triple& triple) {
  return {triple.begin(), triple.end()};
}

/// Values with their covariance, so that a customer can propagate it.
void add_values(XmlElement& results, const Words& words, const std::string& ref_type, const Wording& name,
                const ValueList& values) {
  XmlElement data = add_result(results, ref_type, name);
  add_list(data, words, name, values);
}

Eigen::MatrixXd block(const Eigen::MatrixXd& covariance, Eigen::Index first) {
  return covariance.block(first, first, 3, 3);
}

/// Labels of outputs, with `s` for sensitivity.
std::vector<std::string> output_labels(std::span<const std::string_view> symbols, const std::string& s) {
  std::vector<std::string> all;
  for (const std::string_view symbol : symbols)
    all.push_back(symbol.starts_with("s_") ? s + std::string(symbol.substr(1)) : std::string(symbol));
  return all;
}
std::vector<std::string> twelve_labels(const std::string& s) {
  return output_labels(std::span(kOutputSymbols).first<12>(), s);
}

/// Quantities with their derivatives, from which their covariance is computed.
using DerivedList = std::vector<DerivedQuantity>;

std::vector<Quantity> values_of(const DerivedList& list) {
  std::vector<Quantity> values;
  for (const DerivedQuantity& quantity : list) values.push_back(quantity.value);
  return values;
}

Eigen::MatrixXd covariance_of(const CalibrationResult& result, const DerivedList& list) {
  const auto n = static_cast<Eigen::Index>(list.size());
  return Eigen::MatrixXd::NullaryExpr(n, n, [&](Eigen::Index i, Eigen::Index j) {
    return covariance_of(result, list[static_cast<std::size_t>(i)], list[static_cast<std::size_t>(j)]);
  });
}

/// The list with the marks of the scope. Each value is named by the group and by the part of its label after
/// "_": "offset" and "O_u" are "offset_u".
ValueList marked(const StatedResult& stated, const std::string& group, ValueList list) {
  if (stated.marks.empty()) return list;
  for (const std::string& label : list.labels)
    list.marks.push_back(stated.mark(group + label.substr(label.rfind('_'))));
  return list;
}

/// The same for the sensitivities row by row, which the offsets follow.
ValueList all_marked(const StatedResult& stated, ValueList list) {
  list = marked(stated, "sensitivity", std::move(list));
  for (std::size_t i = 9; i < list.marks.size(); ++i)
    list.marks[i] = stated.mark("offset" + list.labels[i].substr(list.labels[i].rfind('_')));
  return list;
}

/// In SI units: sensitivities per m/s2, to which the uncertainty of local gravity belongs.
void add_si(XmlElement& results, const Words& words, const StatedResult& stated) {
  const CalibrationResult& result = stated.result;
  const DerivedList &sensitivity = stated.group("sensitivity"),
                    &intrinsic = stated.group("intrinsic_sensitivity");
  XmlElement matrix = add_result(
      results, "abc_sensitivityMatrix", words("Sensitivity matrix"),
      result.stage_record
          ? words("Rows u, v, w; columns x, y, z of the platter, in the frame of the axes that the "
                  "record of the stage states. Specific force at rest points up.")
          : words("Rows u, v, w; columns x, y, z of the platter. Specific force at rest points up."));
  add_rows(matrix, words, [&](std::size_t j) {
    const auto first = sensitivity.begin() + static_cast<std::ptrdiff_t>(3 * j);
    const DerivedList row(first, first + 3);
    return marked(stated, "sensitivity",
                  list_of(row_labels("s", j), values_of(row), covariance_of(result, row)));
  });
  add_values(
      results, words, "abc_intrinsicSensitivities", words("Intrinsic sensitivities"),
      marked(stated, "intrinsic_sensitivity",
             list_of(labels("s", kOutputNames), values_of(intrinsic), covariance_of(result, intrinsic))));
  const Eigen::MatrixXd nine = *result.covariance_intrinsic;
  add_values(results, words, "abc_intrinsicAngles",
             words("Intrinsic angles between the sensitive directions"),
             marked(stated, "intrinsic_angle",
                    list_of(labels("phi", kOutputPairs), as_vector(result.intrinsic_angle), block(nine, 3))));
  add_values(
      results, words, "abc_offsets", words("Zero-acceleration offsets"),
      marked(stated, "offset", list_of(labels("O", kOutputNames), as_vector(result.offset), block(nine, 6))));
}

/// Results in the form of the analysis: change of the output for one g_loc. They do not include the
/// uncertainty of local gravity.
void add_per_gravity(XmlElement& results, const Words& words, const StatedResult& stated) {
  const CalibrationResult& result = stated.result;
  const std::string s = "g_loc*s";
  XmlElement matrix =
      add_result(results, "abc_sensitivityMatrixPerGravity", words("Sensitivity matrix per local gravity"),
                 words("Change of the output for an acceleration of one local gravity g_loc, which is among "
                       "the conditions; its uncertainty does not enter."));
  std::vector<Quantity> twelve;
  add_rows(matrix, words, [&](std::size_t j) {
    const auto& row = (*result.sensitivity_matrix)[j];
    twelve.insert(twelve.end(), row.begin(), row.end());
    return marked(stated, "sensitivity",
                  list_of(row_labels(s, j), {row.begin(), row.end()},
                          block(*result.covariance, static_cast<Eigen::Index>(3 * j))));
  });
  add_values(results, words, "abc_intrinsicSensitivitiesPerGravity",
             words("Intrinsic sensitivities per local gravity"),
             marked(stated, "intrinsic_sensitivity",
                    list_of(labels(s, kOutputNames), as_vector(result.intrinsic_sensitivity),
                            block(*result.covariance_intrinsic, 0))));
  twelve.insert(twelve.end(), result.offset.begin(), result.offset.end());
  add_values(results, words, "abc_allOutputsPerGravity",
             words("Sensitivity matrix per local gravity row by row and offsets, with their covariance"),
             all_marked(stated, list_of(twelve_labels(s), twelve, *result.covariance)));
}

/// "transverse_sensitivity" as "abc_transverseSensitivity".
std::string ref_type_of(const std::string& group) {
  std::string name = "abc_";
  bool upper = false;
  for (const char c : group) {
    if (c == '_') {
      upper = true;
      continue;
    }
    name += upper ? static_cast<char>(std::toupper(static_cast<unsigned char>(c))) : c;
    upper = false;
  }
  return name;
}

void add_derived_group(XmlElement& results, const Words& words, const StatedResult& stated,
                       const DerivedGroup& group, const std::pair<std::string, Wording>& heading) {
  const auto& [ref_type, name] = heading;
  std::vector<Quantity> values;
  std::vector<std::string> names;
  for (const DerivedQuantity& quantity : group.quantities) {
    if (std::isnan(quantity.value.value)) continue;  // Not determined: the description says so.
    values.push_back(quantity.value);
    names.push_back(quantity.name);
  }
  if (values.empty()) return;
  XmlElement data = add_result(results, ref_type, name,
                               values.size() == group.quantities.size()
                                   ? Wording{}
                                   : words("Left out where the transverse sensitivity does not exceed its "
                                           "expanded uncertainty, so that it has no direction."));
  const std::string& first = group.quantities.front().name;
  add_list(data, words, name, marked(stated, first.substr(0, first.rfind('_')), list_of(names, values)));
}

/// Outputs beyond those of the protocol; the annex of the page shows them.
void add_further_outputs(XmlElement& results, const Words& words, const CalibrationResult& result) {
  for (const auto& [about, found] : further_outputs(result)) {
    std::vector<Quantity> values;
    for (const auto& [name, quantity] : found) values.push_back(quantity);
    add_values(results, words, ref_type_of(about.key), words(about.heading), list_of(about.symbols, values));
  }
}

/// A tolerance limit in the SI unit of the decision, and as it is stated where that is another unit.
void add_limit(XmlElement& facts, const std::string& ref_type, const Wording& name,
               const std::pair<double, std::string>& in_si, const std::pair<double, std::string>& stated) {
  XmlElement quantity = add_quantity(facts, ref_type, name);
  const auto add_real = [&](XmlElement& parent, const std::pair<double, std::string>& number) {
    XmlElement real = parent.add("si:real");
    real.add("si:value", dsi_number(number.first, name.text));
    real.add("si:unit", number.second);
  };
  if (in_si.second == stated.second) return add_real(quantity, in_si);
  XmlElement both = quantity.add("si:hybrid");
  add_real(both, in_si);
  add_real(both, stated);
}

void add_decision(XmlElement& data, const Words& words, const StatedResult& result,
                  const Decision& decision) {
  const SpecificationLimit &limit = decision.limit, &stated = decision.stated;
  XmlElement quantity = add_quantity(data, "basic_measuredValue", {limit.quantity, {}});
  add_value(quantity, decision.quantity, limit.quantity);
  XmlElement metadata = quantity.add("dcc:measurementMetaData");
  XmlElement conformity =
      add_metadatum(metadata, "basic_conformity", words("Conformity of {name}", limit.quantity));
  if (decision.conformity == Conformity::kUndecided)
    add_words(conformity, "dcc:description",
              words("None possible: U is so large that the guard band leaves no value to accept."));
  add_line(conformity, "dcc:reference", limit.source);
  // The schema has no word for a decision that is not possible.
  if (decision.conformity != Conformity::kUndecided)
    conformity.add("dcc:conformity", to_string(decision.conformity));
  XmlElement facts = conformity.add("dcc:data");
  const UnitInDsi in = unit_in_dsi(stated.unit, result.result.g_loc.value);
  const std::string own = in.own ? in.own->text() : in.unit.text();
  const auto add_tolerance = [&](const std::string& ref_type, const Wording& name,
                                 const std::optional<double>& in_si, const std::optional<double>& as_stated) {
    if (in_si && as_stated) add_limit(facts, ref_type, name, {*in_si, limit.unit}, {*as_stated, own});
  };
  add_tolerance("basic_toleranceLimitLower", words("lower tolerance limit"), limit.lower, stated.lower);
  add_tolerance("basic_toleranceLimitUpper", words("upper tolerance limit"), limit.upper, stated.upper);
  // Numbers that follow from U have the digits of U.
  const auto add_rounded = [&](const std::string& ref_type, const Wording& name,
                               const std::optional<double>& of) {
    if (!of) return;
    XmlElement real = add_quantity(facts, ref_type, name).add("si:real");
    real.add("si:value", rounded_value(*of, decision.expanded_uncertainty, limit.quantity).value);
    real.add("si:unit", limit.unit);
  };
  add_rounded("basic_acceptanceLimitLower", words("lower acceptance limit"), decision.lower_acceptance);
  add_rounded("basic_acceptanceLimitUpper", words("upper acceptance limit"), decision.upper_acceptance);
  add_rounded("abc_guardBand", words("guard band"), decision.guard_band);
  add_number(facts, fmt::format("abc_rule_{}", kDecisionRules.of(decision.rule.kind, "")),
             words("guard factor of the decision rule, where it has one"),
             dsi_number(decision.rule.guard_factor, limit.quantity), "1");
  const auto add_probability = [&](const char* ref_type, const Wording& name, double probability) {
    constexpr double kDigits = 1e4;
    add_number(facts, ref_type, name, dsi_number(std::round(probability * kDigits) / kDigits, limit.quantity),
               "1");
  };
  add_probability("abc_conformanceProbability",
                  words("probability that the true value lies inside the tolerance limits"),
                  decision.conformance_probability);
  if (decision.risk)
    add_probability("abc_risk",
                    words("largest probability that the true value of an accepted one lies outside"),
                    *decision.risk);
  add_scope_marks(metadata, words, {limit.quantity}, {result.mark(limit.quantity)});
}

void add_shifts(XmlElement& results, const Words& words, const StatedResult& stated,
                const std::vector<Shift>& shifts) {
  if (shifts.empty()) return;
  XmlElement data = add_result(results, "abc_shift", words("As left minus as found"),
                               words("Uncertainties take both calibrations as independent, an upper bound "
                                     "where they were made on the same stage."));
  for (const Shift& shift : shifts) {
    XmlElement quantity = add_quantity(data, "abc_difference", {shift.name, {}});
    add_value(quantity, shift.difference, "shift of " + shift.name);
    XmlElement metadata = quantity.add("dcc:measurementMetaData");
    const Wording name = words("E_n, difference divided by its expanded uncertainty");
    XmlElement error = add_metadatum(metadata, "abc_normalisedError", name);
    XmlElement facts = error.add("dcc:data");
    add_number(facts, "abc_normalisedError", name, fmt::format("{:.2f}", shift.normalised_error), "1");
    add_scope_marks(metadata, words, {shift.name}, {stated.mark(shift.name)});
  }
}

void add_results(XmlElement& measurement, const Words& words, const CertifiedRun& run,
                 const std::vector<Shift>& shifts) {
  XmlElement results = measurement.add("dcc:results");
  const StatedResult& stated = run.stated;
  if (!run.has_numbers()) {
    XmlElement data = add_result(results, "abc_noResult", words("No result"));
    add_words(data, "dcc:text",
              words("No numbers are given, since the run gave none that may be used: {why}",
                    run.data.result().why));
    return;
  }
  add_si(results, words, stated);
  add_response_at_rates(results, words, stated);
  const std::optional<CustomerEquation> equation = customer_equation(stated);
  if (equation) add_customer_equation(results, words, *equation);
  add_per_gravity(results, words, stated);
  add_further_outputs(results, words, stated.result);
  int unit = 0;
  for (const DerivedGroup& group : stated.derived) {
    if (group.name == "sensitivity" || group.name == "intrinsic_sensitivity") continue;
    if (!group.name.starts_with("sensitivity [")) {
      add_derived_group(results, words, stated, group, {ref_type_of(group.name), words(group.words)});
      continue;
    }
    const std::string& own = group.quantities.front().value.unit;
    const Wording name = own.ends_with("/g_n") ? words("Sensitivity in {unit}, with standard gravity", own)
                                               : words("Sensitivity in {unit}", own);
    add_derived_group(results, words, stated, group, {fmt::format("abc_sensitivityInUnit{}", ++unit), name});
  }
  if (!run.decisions.empty()) {
    XmlElement data =
        add_result(results, "abc_conformity", words("Conformity with specification"),
                   words("Each limit is converted to the SI unit of its quantity once; each "
                         "decision is made from the printed numbers. P: probability that the true "
                         "value lies inside the tolerance. Risk: the largest probability that it "
                         "lies outside although the measured value is accepted. Both are those "
                         "of Student's distribution with the degrees of freedom of U."));
    for (const Decision& decision : run.decisions) add_decision(data, words, stated, decision);
  }
  add_shifts(results, words, stated, shifts);
  add_state(results, words, stated, equation);
  if (run.data.budget) add_budget(results, words, *run.data.budget, run);
}

void add_measurement(XmlElement& measurements, const Certificate& certificate, const CertifiedRun& run,
                     const ItemState& state, const std::vector<Shift>& shifts) {
  const Words& words = certificate.words;
  XmlElement measurement = measurements.add("dcc:measurementResult");
  measurement.attribute("refType", "abc_calibration");
  std::string name = words("Calibration by rotations in gravity (ABC protocol)").text;
  if (!state.words.empty()) name += ", " + words(state.words).text;
  if (certificate.draft()) name = words("DRAFT").text + ": " + name;
  add_words(measurement, "dcc:name", words.as_given(name));
  (void)add_methods(measurement, certificate, run.data);
  add_used_software(measurement, certificate, run.data);
  add_equipment(measurement, certificate, run.data);
  add_conditions(measurement, certificate, runs_of_result(run.together, run.data), state);
  add_results(measurement, words, run, shifts);
  add_metadata(measurement, certificate, run);
}

}  // namespace

void add_measurement_results(XmlElement& root, const Certificate& certificate) {
  XmlElement measurements = root.add("dcc:measurementResults");
  if (certificate.as_found) {
    add_measurement(measurements, certificate, *certificate.as_found,
                    {Message("as found"), "beforeAdjustment"}, {});
    add_measurement(measurements, certificate, certificate.run, {Message("as left"), "afterAdjustment"},
                    certificate.shifts);
  } else {
    add_measurement(measurements, certificate, certificate.run, {}, {});
  }
  if (certificate.series && certificate.series->result) add_temperature_series(measurements, certificate);
}

}  // namespace abcal
