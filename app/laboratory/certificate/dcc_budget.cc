#include "app/laboratory/certificate/dcc_budget.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>
#include <vector>

#include "app/formats/dsi_unit.h"
#include "app/formats/typed_unit.h"
#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {
namespace {

/// D-SI unit of an input of the budget, and the number of these units in one of the input's own.
std::pair<std::string, double> input_unit(const std::string& unit) {
  if (unit == "urad") return {"\\micro\\radian", 1.0};
  if (unit == "degree") return {"\\degree", 1.0};
  if (unit == "of S" || unit == "1" || unit.empty()) return {"\\one", 1.0};
  const UnitInDsi in = unit_in_dsi(unit);
  return {in.unit.text(), in.factor};
}

/// Name of output k as in a laboratory file: "sensitivity_ux", "intrinsic_angle_uv".
std::string name_of_output(int k) {
  const std::string symbol(output_symbol(k));
  const std::string of = symbol.substr(symbol.find('_'));
  if (k < kFirstOffset) return "sensitivity" + of;
  if (k < kFirstIntrinsicSensitivity) return "offset" + of;
  return (k < kFirstIntrinsicAngle ? "intrinsic_sensitivity" : "intrinsic_angle") + of;
}

std::string two_digits(double value, const std::string& what) {
  if (!std::isfinite(value)) throw NumberNotFinite(what + " is not a finite number");
  return value == 0.0 ? "0" : rounded_value(0.0, value, what).expanded;
}

/// Outputs of one unit in the order of study_output.h.
struct OutputGroup {
  Term name;
  std::vector<int> outputs;
  std::string unit;     ///< Unit of the contributions that are given.
  double factor = 1.0;  ///< Number of these in one unit of the budget.
};

/// Sensitivities are per m/s2, as everywhere in the certificate, and not per local gravity as in the
/// analysis.
std::vector<OutputGroup> output_groups(const std::string& response_unit, double g_loc_mps2) {
  OutputGroup sensitivities{"contribution to sensitivities",
                            {},
                            TypedUnit{response_unit, PerAcceleration::kSi}.name(),
                            1.0 / g_loc_mps2};
  OutputGroup offsets{"contribution to offsets", {}, response_unit};
  OutputGroup angles{"contribution to angles", {}, "degree"};
  for (int k = 0; k < kStudyOutputs; ++k) {
    const bool offset = k >= kFirstOffset && k < kFirstIntrinsicSensitivity;
    (k >= kFirstIntrinsicAngle ? angles : offset ? offsets : sensitivities).outputs.push_back(k);
  }
  return {sensitivities, offsets, angles};
}

/// One line of the budget as the certificate gives it.
struct BudgetRow {
  Wording input, kind, source;
  std::optional<std::pair<double, std::string>> input_uncertainty;  ///< With its unit of D-SI.
  /// One for each output in the order of study_output.h, in the unit of its group.
  OutputVector contribution = OutputVector::Zero();
  OutputVector degrees_of_freedom = OutputVector::Constant(std::numeric_limits<double>::infinity());
};

/// Degrees of freedom of the contributions, where they are few, and the source of the input.
void add_row_metadata(XmlElement& list, const Words& words, const BudgetRow& row) {
  constexpr double kManyDegrees = 1000.0;  // From here on k is that of infinitely many, to all its digits.
  std::vector<std::string> labels, degrees;
  for (int k = 0; k < kStudyOutputs; ++k) {
    if (!(row.contribution(k) > 0.0 && row.degrees_of_freedom(k) < kManyDegrees)) continue;
    labels.emplace_back("nu(" + std::string(output_symbol(k)) + ")");
    degrees.push_back(fmt::format("{:.0f}", std::floor(row.degrees_of_freedom(k))));
  }
  XmlElement metadata = list.add("dcc:measurementMetaData");
  if (!labels.empty()) {
    const Wording name = words("Degrees of freedom of the contributions");
    XmlElement data = add_metadatum(metadata, "abc_degreesOfFreedom", name).add("dcc:data");
    XmlElement of = add_quantity(data, "abc_degreesOfFreedom", name);
    add_number_list(of, labels, degrees, "\\one");
  }
  XmlElement source = add_metadatum(metadata, "abc_source", words("Source"));
  add_text(source, row.source);
}

void add_row(XmlElement& budget, const Words& words, const std::vector<OutputGroup>& groups,
             const BudgetRow& row) {
  XmlElement list = budget.add("dcc:list");
  list.attribute("refType", "abc_budgetLine");
  add_words(list, "dcc:name", row.input);
  add_words(list, "dcc:description", row.kind);
  if (row.input_uncertainty) {
    XmlElement input = add_quantity(list, "abc_inputUncertainty", words("standard uncertainty of the input"));
    XmlElement real = input.add("si:real");
    real.add("si:value", two_digits(row.input_uncertainty->first, row.input.text));
    real.add("si:unit", row.input_uncertainty->second);
  }
  for (const OutputGroup& group : groups) {
    const UnitInDsi in = unit_in_dsi(group.unit);
    std::vector<std::string> labels, numbers;
    for (const int k : group.outputs) {
      labels.emplace_back(output_symbol(k));
      numbers.push_back(two_digits(row.contribution(k) * in.factor, "contribution of " + row.input.text));
    }
    XmlElement quantity = add_quantity(list, "abc_contribution", words(group.name));
    add_number_list(quantity, labels, numbers, in.unit.text());
  }
  add_row_metadata(list, words, row);
}

/// Standard uncertainties of the outputs as the certificate states them, each in the unit of its group.
OutputVector stated_uncertainties(const StatedResult& stated) {
  OutputVector u = OutputVector::Zero();
  for (int k = 0; k < kStudyOutputs; ++k)
    if (const auto quantity = stated_quantity(stated, name_of_output(k)))
      u(k) = quantity->standard_uncertainty;
  return u;
}

/// Relative uncertainty of local gravity in all sensitivities per m/s2.
OutputVector from_local_gravity(const StatedResult& stated) {
  OutputVector contribution = OutputVector::Zero();
  const Quantity& g_loc = stated.result.g_loc;
  for (int k = 0; k < kFirstIntrinsicAngle; ++k) {
    if (k >= kFirstOffset && k < kFirstIntrinsicSensitivity) continue;
    if (const auto quantity = stated_quantity(stated, name_of_output(k)))
      contribution(k) = std::abs(quantity->value) * g_loc.standard_uncertainty / g_loc.value;
  }
  return contribution;
}

}  // namespace

void add_budget(XmlElement& results, const Words& words, const Budget& budget, const CertifiedRun& run) {
  XmlElement data = add_result(
      results, "abc_budget", words("Uncertainty budget"),
      words("To first order (JCGM 100): what each input contributes to the standard uncertainty of each "
            "output, in SI units. The sum of squares is the square of the standard uncertainty U/k."));
  const std::vector<OutputGroup> groups =
      output_groups(run.data.record.response_unit, run.stated.result.g_loc.value);
  OutputVector squares = OutputVector::Zero();
  const auto add = [&](const BudgetRow& row) {
    add_row(data, words, groups, row);
    squares += row.contribution.cwiseAbs2();
  };
  for (const BudgetLine& line : budget.lines) {
    BudgetRow row;
    row.input = words(line.input);
    row.source = source_words(words, line.source);
    row.degrees_of_freedom = line.degrees_of_freedom;
    row.kind = line.type_a ? words("type A, {distribution}", word_of(kDistributions, line.distribution))
                           : words("type B, {distribution}", word_of(kDistributions, line.distribution));
    if (std::isfinite(line.standard_uncertainty)) {
      const auto [unit, factor] = input_unit(line.unit);
      row.input_uncertainty = {line.standard_uncertainty * factor, unit};
    }
    for (const OutputGroup& group : groups)
      for (const int k : group.outputs) row.contribution(k) = line.contribution(k) * group.factor;
    // The analysis is per local gravity, to which it contributes nothing.
    if (line.is_local_gravity) row.contribution = from_local_gravity(run.stated);
    if (row.contribution.isZero(0.0)) continue;  // It does not apply.
    add(row);
  }
  const OutputVector stated = stated_uncertainties(run.stated);
  BudgetRow raise;
  for (int k = 0; k < kStudyOutputs; ++k) {
    const ScopeMark mark = run.stated.mark(name_of_output(k));
    // The budget has rounded nothing yet: what is left of an output that was not raised is rounding.
    constexpr double kRaised = 1.0 + 1e-6;
    if (mark != ScopeMark::kNone && stated(k) * stated(k) > kRaised * squares(k))
      raise.contribution(k) = std::sqrt(stated(k) * stated(k) - squares(k));
  }
  if (raise.contribution.isZero(0.0)) return;
  raise.input = words("raised to the smallest uncertainty of the laboratory's scope (CMC)");
  raise.kind = words("type B, {distribution}", Message("normal"));
  raise.source = words("the laboratory's scope");
  add(raise);
}

}  // namespace abcal
