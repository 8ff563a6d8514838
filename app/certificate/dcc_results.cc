#include "app/certificate/dcc_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "app/certificate/dcc_conditions.h"
#include "app/certificate/dcc_text.h"
#include "app/certificate/dsi_list.h"
#include "protocol/analysis/intrinsic_properties.h"

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
  for (const char* axis : kPlatterAxes) list.push_back(symbol + "_" + kAccelerometers[row] + axis);
  return list;
}

XmlElement add_result(XmlElement& results, const std::string& ref_type, const std::string& name,
                      const std::string& description = {}) {
  XmlElement result = results.add("dcc:result");
  result.attribute("refType", ref_type);
  add_words(result, "dcc:name", name);
  if (!description.empty()) add_words(result, "dcc:description", description);
  return result.add("dcc:data");
}

XmlElement add_quantity(XmlElement& parent, const std::string& ref_type, const std::string& name) {
  XmlElement quantity = parent.add("dcc:quantity");
  quantity.attribute("refType", ref_type);
  add_words(quantity, "dcc:name", name);
  return quantity;
}

void add_rows(XmlElement& data, const std::string& ref_type,
              const std::function<ValueList(std::size_t)>& row) {
  XmlElement list = data.add("dcc:list");
  list.attribute("refType", ref_type);
  for (std::size_t j = 0; j < 3; ++j) {
    XmlElement quantity =
        add_quantity(list, "basic_measuredValue", std::string("row of accelerometer ") + kAccelerometers[j]);
    add_value_list(quantity, row(j));
  }
}

std::vector<Quantity> as_vector(const Triple& triple) {
  return {triple.begin(), triple.end()};
}

/// Values with their covariance, so that a customer can propagate it.
void add_values(XmlElement& results, const std::string& ref_type, const std::string& name,
                const ValueList& values) {
  XmlElement data = add_result(results, ref_type, name);
  XmlElement quantity = add_quantity(data, "basic_measuredValue", name);
  add_value_list(quantity, values);
}

Eigen::MatrixXd block(const Eigen::MatrixXd& covariance, Eigen::Index first) {
  return covariance.block(first, first, 3, 3);
}

/// Labels of the twelve outputs, or of the nine that do not depend on the mounting, with `s` for sensitivity.
std::vector<std::string> output_labels(const std::string& s) {
  std::vector<std::string> all;
  for (std::size_t j = 0; j < 3; ++j)
    for (const std::string& label : row_labels(s, j)) all.push_back(label);
  for (const std::string& label : labels("O", kAccelerometers)) all.push_back(label);
  return all;
}
std::vector<std::string> intrinsic_labels(const std::string& s) {
  std::vector<std::string> all = labels(s, kAccelerometers);
  for (const std::string& label : labels("phi", kPairs)) all.push_back(label);
  for (const std::string& label : labels("O", kAccelerometers)) all.push_back(label);
  return all;
}

/// Quantities with their derivatives, so that their covariance can be had.
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

const DerivedList& group_of(const CertifiedRun& run, const std::string& name) {
  const auto found = std::find_if(run.derived.begin(), run.derived.end(),
                                  [&](const DerivedGroup& group) { return group.name == name; });
  if (found == run.derived.end()) throw std::logic_error("nothing was derived as " + name);
  return found->quantities;
}

DerivedList offsets_of(const CalibrationResult& result) {
  DerivedList list;
  for (std::size_t j = 0; j < 3; ++j) {
    DerivedQuantity& offset = list.emplace_back();
    offset.value = result.offset[j];
    offset.gradient[9 + static_cast<Eigen::Index>(j)] = 1.0;
  }
  return list;
}

DerivedList angles_of(const CalibrationResult& result) {
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(result.sensitivity_values());
  DerivedList list;
  for (std::size_t j = 0; j < 3; ++j) {
    DerivedQuantity& angle = list.emplace_back();
    angle.value = result.intrinsic_angle[j];
    angle.gradient.head<12>() = jacobian.row(3 + static_cast<Eigen::Index>(j)).transpose();
  }
  return list;
}

DerivedList joined(DerivedList list, const DerivedList& more) {
  list.insert(list.end(), more.begin(), more.end());
  return list;
}

/// In SI units: sensitivities per m/s2, to which the uncertainty of local gravity belongs.
void add_si(XmlElement& results, const CertifiedRun& run) {
  const CalibrationResult& result = run.data.result();
  const DerivedList &sensitivity = group_of(run, "sensitivity"),
                    &intrinsic = group_of(run, "intrinsic_sensitivity");
  const std::string frame = "Rows u, v, w; columns x, y, z of the platter. Specific force at rest points up.";
  XmlElement matrix = add_result(results, "abc_sensitivityMatrix", "Sensitivity matrix", frame);
  add_rows(matrix, "abc_matrix3x3", [&](std::size_t j) {
    const auto first = sensitivity.begin() + static_cast<std::ptrdiff_t>(3 * j);
    const DerivedList row(first, first + 3);
    return list_of(row_labels("s", j), values_of(row), covariance_of(result, row));
  });
  add_values(results, "abc_intrinsicSensitivities", "Intrinsic sensitivities",
             list_of(labels("s", kAccelerometers), values_of(intrinsic), covariance_of(result, intrinsic)));
  const Eigen::MatrixXd nine = *result.covariance_intrinsic;
  add_values(results, "abc_intrinsicAngles", "Intrinsic angles between the sensitive directions",
             list_of(labels("phi", kPairs), as_vector(result.intrinsic_angle), block(nine, 3)));
  add_values(results, "abc_offsets", "Zero-acceleration offsets",
             list_of(labels("O", kAccelerometers), as_vector(result.offset), block(nine, 6)));
  const DerivedList outputs = joined(sensitivity, offsets_of(result));
  add_values(results, "abc_allOutputs", "Sensitivity matrix row by row and offsets, with their covariance",
             list_of(output_labels("s"), values_of(outputs), covariance_of(result, outputs)));
  const DerivedList intrinsics = joined(joined(intrinsic, angles_of(result)), offsets_of(result));
  add_values(
      results, "abc_allIntrinsic",
      "Intrinsic sensitivities, intrinsic angles and offsets, with their covariance: what does not depend on "
      "the mounting",
      list_of(intrinsic_labels("s"), values_of(intrinsics), covariance_of(result, intrinsics)));
}

/// As the analysis has them: the change of the output for one g_loc. Local gravity's uncertainty is not in
/// them.
void add_per_gravity(XmlElement& results, const CalibrationResult& result) {
  const std::string s = "g_loc*s";
  const std::string what =
      "Change of the output for an acceleration of one local gravity g_loc, which is among the conditions; "
      "its "
      "uncertainty does not enter.";
  XmlElement matrix =
      add_result(results, "abc_sensitivityMatrixPerGravity", "Sensitivity matrix per local gravity", what);
  std::vector<Quantity> twelve;
  add_rows(matrix, "abc_matrix3x3", [&](std::size_t j) {
    const auto& row = (*result.sensitivity_matrix)[j];
    twelve.insert(twelve.end(), row.begin(), row.end());
    return list_of(row_labels(s, j), {row.begin(), row.end()},
                   block(*result.covariance, static_cast<Eigen::Index>(3 * j)));
  });
  add_values(results, "abc_intrinsicSensitivitiesPerGravity", "Intrinsic sensitivities per local gravity",
             list_of(labels(s, kAccelerometers), as_vector(result.intrinsic_sensitivity),
                     block(*result.covariance_intrinsic, 0)));
  twelve.insert(twelve.end(), result.offset.begin(), result.offset.end());
  add_values(results, "abc_allOutputsPerGravity",
             "Sensitivity matrix per local gravity row by row and offsets, with their covariance",
             list_of(output_labels(s), twelve, *result.covariance));
  std::vector<Quantity> nine = as_vector(result.intrinsic_sensitivity);
  for (const Triple* triple : {&result.intrinsic_angle, &result.offset})
    nine.insert(nine.end(), triple->begin(), triple->end());
  add_values(results, "abc_allIntrinsicPerGravity",
             "Intrinsic sensitivities per local gravity, intrinsic angles and offsets, with their covariance",
             list_of(intrinsic_labels(s), nine, *result.covariance_intrinsic));
}

void add_derived_group(XmlElement& results, const DerivedGroup& group) {
  std::vector<Quantity> values;
  std::vector<std::string> names;
  for (const DerivedQuantity& quantity : group.quantities) {
    if (std::isnan(quantity.value.value)) continue;  // Not determined: the description says so.
    values.push_back(quantity.value);
    names.push_back(quantity.name);
  }
  if (values.empty()) return;
  const std::string missing = values.size() == group.quantities.size()
                                  ? ""
                                  : "Left out where the transverse sensitivity does not exceed its expanded "
                                    "uncertainty, so that it has no direction.";
  XmlElement data = add_result(results, "abc_derived", group.words, missing);
  XmlElement quantity = add_quantity(data, "basic_measuredValue", group.words);
  add_value_list(quantity, list_of(names, values));
}

void add_metadata_quantity(XmlElement& data, const std::string& ref_type, const std::string& name,
                           double value, const std::string& unit) {
  XmlElement quantity = add_quantity(data, ref_type, name);
  Quantity bare;
  bare.value = value;
  bare.unit = unit;
  add_value(quantity, bare, name);
}

void add_decision(XmlElement& data, const Decision& decision) {
  const SpecificationLimit& limit = decision.limit;
  XmlElement quantity = add_quantity(data, "basic_measuredValue", limit.quantity);
  Quantity value;
  value.value = decision.value;
  value.standard_uncertainty = decision.standard_uncertainty;
  value.unit = limit.unit;
  add_value(quantity, value, limit.quantity);
  XmlElement conformity = quantity.add("dcc:measurementMetaData").add("dcc:metaData");
  conformity.attribute("refType", "basic_conformity");
  add_words(conformity, "dcc:name", "Conformity of " + limit.quantity);
  add_line(conformity, "dcc:reference", limit.source);
  conformity.add("dcc:conformity", to_string(decision.conformity));
  XmlElement facts = conformity.add("dcc:data");
  const auto add = [&](const std::string& ref_type, const std::string& name,
                       const std::optional<double>& of) {
    if (of) add_metadata_quantity(facts, ref_type, name, *of, limit.unit);
  };
  add("basic_toleranceLimitLower", "lower tolerance limit", limit.lower);
  add("basic_toleranceLimitUpper", "upper tolerance limit", limit.upper);
  add("basic_acceptanceLimitLower", "lower acceptance limit", decision.lower_acceptance);
  add("basic_acceptanceLimitUpper", "upper acceptance limit", decision.upper_acceptance);
  add("abc_guardBand", "guard band", decision.guard_band);
  add_metadata_quantity(facts, "abc_conformanceProbability",
                        "probability that the true value lies inside the tolerance limits",
                        decision.conformance_probability, "1");
}

void add_shifts(XmlElement& results, const std::vector<Shift>& shifts) {
  if (shifts.empty()) return;
  XmlElement data =
      add_result(results, "abc_shift", "As left minus as found",
                 "Uncertainties take both calibrations as independent, an upper bound where they "
                 "were made on the same stage.");
  for (const Shift& shift : shifts) {
    XmlElement quantity = add_quantity(data, "abc_difference", shift.name);
    add_value(quantity, shift.difference, "shift of " + shift.name);
    XmlElement error = quantity.add("dcc:measurementMetaData").add("dcc:metaData");
    error.attribute("refType", "abc_normalisedError");
    XmlElement facts = error.add("dcc:data");
    add_metadata_quantity(facts, "abc_normalisedError", "E_n, difference divided by its expanded uncertainty",
                          shift.normalised_error, "1");
  }
}

void add_results(XmlElement& measurement, const CertifiedRun& run, const std::vector<Shift>& shifts) {
  XmlElement results = measurement.add("dcc:results");
  const CalibrationResult& result = run.data.result();
  if (!run.has_numbers()) {
    XmlElement data = add_result(results, "abc_noResult", "No result");
    add_words(data, "dcc:text",
              "No numbers are given, since the run gave none that may be used: " + result.why);
    return;
  }
  add_si(results, run);
  add_per_gravity(results, result);
  for (const DerivedGroup& group : run.derived) {
    const bool done = group.name == "sensitivity" || group.name == "intrinsic_sensitivity";
    if (!done) add_derived_group(results, group);
  }
  if (!run.decisions.empty()) {
    XmlElement data = add_result(results, "abc_conformity", "Conformity with specification");
    for (const Decision& decision : run.decisions) add_decision(data, decision);
  }
  add_shifts(results, shifts);
}

void add_measurement(XmlElement& measurements, const Certificate& certificate, const CertifiedRun& run,
                     const ItemState& state, const std::vector<Shift>& shifts) {
  XmlElement measurement = measurements.add("dcc:measurementResult");
  measurement.attribute("refType", "abc_calibration");
  std::string name = "Calibration by rotations in gravity (ABC protocol)";
  if (!state.words.empty()) name += ", " + state.words;
  if (certificate.draft()) name = "DRAFT: " + name;
  add_words(measurement, "dcc:name", name);
  add_methods(measurement, certificate, run.data);
  add_used_software(measurement, certificate, run.data);
  add_equipment(measurement, certificate, run.data);
  add_conditions(measurement, certificate, run.data, state);
  add_results(measurement, run, shifts);
  add_metadata(measurement, run.data);
}

}  // namespace

void add_measurement_results(XmlElement& root, const Certificate& certificate) {
  XmlElement measurements = root.add("dcc:measurementResults");
  if (!certificate.as_found) {
    add_measurement(measurements, certificate, certificate.run, {}, {});
    return;
  }
  add_measurement(measurements, certificate, *certificate.as_found, {"as found", "beforeAdjustment"}, {});
  add_measurement(measurements, certificate, certificate.run, {"as left", "afterAdjustment"},
                  certificate.shifts);
}

}  // namespace abcal
