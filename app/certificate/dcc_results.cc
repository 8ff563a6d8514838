#include "app/certificate/dcc_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "app/certificate/dcc_conditions.h"
#include "app/certificate/dcc_text.h"
#include "app/certificate/dsi_list.h"

namespace abcal {
namespace {

using Triple = std::array<Quantity, 3>;

std::vector<std::string> labels(const std::string& symbol, const std::array<const char*, 3>& of) {
  std::vector<std::string> list;
  for (const char* one : of) list.push_back(symbol + "_" + one);
  return list;
}

std::vector<std::string> row_labels(std::size_t row) {
  std::vector<std::string> list;
  for (const char* platter : kPlatterAxes) list.push_back(std::string("s_") + kAccelerometers[row] + platter);
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

void add_triple(XmlElement& results, const std::string& ref_type, const std::string& name,
                const std::vector<std::string>& of, const Triple& values,
                std::optional<Eigen::MatrixXd> covariance) {
  XmlElement data = add_result(results, ref_type, name);
  XmlElement quantity = add_quantity(data, "basic_measuredValue", name);
  add_value_list(quantity, list_of(of, as_vector(values), std::move(covariance)));
}

/// All outputs in one list, so that a customer can propagate their covariance.
void add_all(XmlElement& results, const CalibrationResult& result) {
  std::vector<std::string> names;
  std::vector<Quantity> values;
  for (std::size_t j = 0; j < 3; ++j) {
    for (const std::string& label : row_labels(j)) names.push_back(label);
    for (const Quantity& quantity : (*result.sensitivity_matrix)[j]) values.push_back(quantity);
  }
  for (std::size_t j = 0; j < 3; ++j) {
    names.push_back(std::string("O_") + kAccelerometers[j]);
    values.push_back(result.offset[j]);
  }
  XmlElement data = add_result(results, "abc_allOutputs",
                               "Sensitivity matrix row by row and offsets, with their "
                               "covariance");
  XmlElement quantity = add_quantity(data, "basic_measuredValue", "twelve outputs");
  add_value_list(quantity, list_of(names, values, Eigen::MatrixXd(*result.covariance)));
}

void add_all_intrinsic(XmlElement& results, const CalibrationResult& result) {
  std::vector<std::string> names = labels("s", kAccelerometers);
  for (const std::string& label : labels("phi", kPairs)) names.push_back(label);
  for (const std::string& label : labels("O", kAccelerometers)) names.push_back(label);
  std::vector<Quantity> values = as_vector(result.intrinsic_sensitivity);
  for (const Triple* triple : {&result.intrinsic_angle, &result.offset})
    values.insert(values.end(), triple->begin(), triple->end());
  XmlElement data = add_result(results, "abc_allIntrinsic",
                               "Intrinsic sensitivities, intrinsic angles and offsets, with their covariance",
                               "What does not depend on how the accelerometer was mounted.");
  XmlElement quantity = add_quantity(data, "basic_measuredValue", "nine outputs");
  add_value_list(quantity, list_of(names, values, Eigen::MatrixXd(*result.covariance_intrinsic)));
}

Eigen::MatrixXd block(const Eigen::MatrixXd& covariance, Eigen::Index first) {
  return covariance.block(first, first, 3, 3);
}

void add_outputs(XmlElement& results, const CalibrationResult& result) {
  const std::string unit =
      "Change of the output for an acceleration of one local gravity g_loc, which is among the conditions. "
      "Specific force at rest points up.";
  XmlElement matrix = add_result(results, "abc_sensitivityMatrix",
                                 "Sensitivity matrix per local gravity: rows u, v, w; columns x, y, z", unit);
  add_rows(matrix, "abc_matrix3x3", [&](std::size_t j) {
    const auto& row = (*result.sensitivity_matrix)[j];
    return list_of(row_labels(j), {row.begin(), row.end()},
                   block(*result.covariance, static_cast<Eigen::Index>(3 * j)));
  });
  const Eigen::MatrixXd intrinsic = *result.covariance_intrinsic;
  add_triple(results, "abc_intrinsicSensitivities", "Intrinsic sensitivities per local gravity",
             labels("s", kAccelerometers), result.intrinsic_sensitivity, block(intrinsic, 0));
  add_triple(results, "abc_intrinsicAngles", "Intrinsic angles between the sensitive directions",
             labels("phi", kPairs), result.intrinsic_angle, block(intrinsic, 3));
  add_triple(results, "abc_offsets", "Zero-acceleration offsets", labels("O", kAccelerometers), result.offset,
             block(intrinsic, 6));
  add_all(results, result);
  add_all_intrinsic(results, result);
}

void add_derived_group(XmlElement& results, const DerivedGroup& group, const CalibrationResult& result) {
  std::vector<Quantity> values;
  std::vector<std::string> names;
  std::vector<const DerivedQuantity*> determined;
  for (const DerivedQuantity& quantity : group.quantities) {
    if (std::isnan(quantity.value.value)) continue;  // Not determined: said in the description.
    values.push_back(quantity.value);
    names.push_back(quantity.name);
    determined.push_back(&quantity);
  }
  if (values.empty()) return;
  const std::string missing = determined.size() == group.quantities.size()
                                  ? ""
                                  : "Left out where the transverse sensitivity does not exceed its expanded "
                                    "uncertainty, so that it has no direction.";
  XmlElement data = add_result(results, "abc_derived", group.words, missing);
  if (group.name == "sensitivity") {
    // A matrix again: row by row, each with its covariance.
    add_rows(data, "abc_matrix3x3", [&](std::size_t j) {
      Eigen::MatrixXd covariance(3, 3);
      for (Eigen::Index a = 0; a < 3; ++a)
        for (Eigen::Index b = 0; b < 3; ++b)
          covariance(a, b) = covariance_of(result, *determined[3 * j + static_cast<std::size_t>(a)],
                                           *determined[3 * j + static_cast<std::size_t>(b)]);
      const auto first = static_cast<std::ptrdiff_t>(3 * j);
      return list_of(row_labels(j), {values.begin() + first, values.begin() + first + 3}, covariance);
    });
    return;
  }
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
  add_outputs(results, result);
  for (const DerivedGroup& group : run.derived) add_derived_group(results, group, result);
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
