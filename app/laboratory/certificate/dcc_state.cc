#include "app/laboratory/certificate/dcc_state.h"

#include <fmt/format.h>

#include <cmath>
#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "app/formats/dsi_unit.h"
#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"

namespace abcal {
namespace {

/// Quantities of several units, in their order.
struct Labelled {
  std::vector<std::string> labels;
  std::vector<UnitInDsi> units;

  void add(const std::string& label, const std::string& unit) {
    labels.push_back(label);
    units.push_back(unit_in_dsi(unit));
  }
  /// The first after `from` that has another unit.
  std::size_t end_of_unit(std::size_t from) const {
    std::size_t end = from;
    while (end < units.size() && units[end].unit.text() == units[from].unit.text()) ++end;
    return end;
  }
};

/// Adds numbers as one quantity for each unit.
/// @param number  of a label, in SI units
void add_in_units(XmlElement& parent, const char* ref_type, const Wording& name, const Labelled& of,
                  const std::function<double(std::size_t)>& number, const DsiUnit& times = {}) {
  for (std::size_t from = 0, end = 0; from < of.labels.size(); from = end) {
    end = of.end_of_unit(from);
    std::vector<std::string> labels, numbers;
    for (std::size_t i = from; i < end; ++i) {
      labels.push_back(of.labels[i]);
      numbers.push_back(dsi_number(number(i), name.text + " " + of.labels[i]));
    }
    XmlElement quantity = add_quantity(parent, ref_type, name);
    add_number_list(quantity, labels, numbers, (of.units[from].unit * times).text());
  }
}

/// @param covariance  in the units of the results
void add_covariance(XmlElement& data, const char* ref_type, const Wording& name, const Labelled& of,
                    const Eigen::MatrixXd& covariance) {
  XmlElement list = data.add("dcc:list");
  list.attribute("refType", ref_type);
  add_words(list, "dcc:name", name);
  for (std::size_t i = 0; i < of.labels.size(); ++i)
    add_in_units(
        list, kCovarianceRow, {of.labels[i], {}}, of,
        [&](std::size_t j) {
          return covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) * of.units[i].factor *
                 of.units[j].factor;
        },
        of.units[i].unit);
}

}  // namespace

void add_state(XmlElement& results, const Words& words, const StatedResult& stated,
               const std::optional<CustomerEquation>& equation) {
  const CalibrationResult& result = stated.result;
  Labelled outputs, of_equation;
  std::vector<const Quantity*> quantities;
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      const DerivedQuantity& one = stated.group("sensitivity")[3 * j + k];
      outputs.add(fmt::format("s_{}{}", kOutputNames[j], kPlatterAxes[k]), one.value.unit);
      quantities.push_back(&one.value);
    }
  }
  for (std::size_t j = 0; j < 3; ++j) {
    outputs.add(fmt::format("O_{}", kOutputNames[j]), result.offset[j].unit);
    quantities.push_back(&result.offset[j]);
  }
  XmlElement data = add_result(
      results, kStateType, words("Values and covariances with all digits"),
      words(
          "For programs: every other number of this calibration follows from these, from the stated mounting "
          "and from the limits. They include the uncertainty of local gravity."));
  add_in_units(data, kStateValues, words("Sensitivity matrix row by row and offsets"), outputs,
               [&](std::size_t i) { return quantities[i]->value * outputs.units[i].factor; });
  Labelled gravity;
  gravity.add("g_loc", "m/s2");
  gravity.add("u_g_loc", "m/s2");
  add_in_units(
      data, kStateGravity, words("Local gravity and its standard uncertainty"), gravity,
      [&](std::size_t i) { return i == 0 ? result.g_loc.value : result.g_loc.standard_uncertainty; });
  std::vector<std::string> labels, degrees;
  for (std::size_t i = 0; i < quantities.size(); ++i) {
    // With local gravity an output may have others.
    const double own = i < 9 ? (*result.sensitivity_matrix)[i / 3][i % 3].degrees_of_freedom
                             : result.offset[i - 9].degrees_of_freedom;
    if (!std::isfinite(own)) continue;
    labels.push_back(outputs.labels[i]);
    degrees.push_back(dsi_number(own, outputs.labels[i]));
  }
  if (!labels.empty()) {
    XmlElement finite = add_quantity(data, kStateDegrees, words("Effective degrees of freedom"));
    add_number_list(finite, labels, degrees, "\\one");
  }
  const Wording all = words("Covariance of the sensitivity matrix row by row and the offsets");
  add_covariance(data, kStateCovariance, all, outputs, covariance_of_outputs(stated, *result.covariance));
  if (stated.measured != *result.covariance)
    add_covariance(data, kMeasuredCovariance,
                   words("The same before it was raised to the scope of the laboratory"), outputs,
                   covariance_of_outputs(stated, stated.measured));
  if (!equation) return;
  for (std::size_t i = 0; i < equation->M.size(); ++i)
    of_equation.add(equation_labels()[i], equation->M[i].value.unit);
  for (std::size_t j = 0; j < 3; ++j) of_equation.add(equation_labels()[9 + j], result.offset[j].unit);
  add_covariance(data, kEquationCovariance, words("Covariance of matrix M row by row and offsets b"),
                 of_equation, equation->covariance);
}

}  // namespace abcal
