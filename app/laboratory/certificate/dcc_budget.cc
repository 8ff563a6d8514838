#include "app/laboratory/certificate/dcc_budget.h"

#include <fmt/format.h>

#include <cmath>
#include <string_view>
#include <utility>

#include "app/ground/units/dsi_unit.h"
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

/// "wobble of X, 12 unknowns" in the language.
Wording input_words(const Words& words, const std::string& input) {
  constexpr std::string_view kUnknowns = " unknowns";
  const std::size_t comma = input.rfind(", ");
  if (comma == std::string::npos || !input.ends_with(kUnknowns)) return words.as_given(words.known(input));
  const std::string count = input.substr(comma + 2, input.size() - comma - 2 - kUnknowns.size());
  return words("{}, {} unknowns", words.known(input.substr(0, comma)), count);
}

std::string two_digits(double value, const std::string& what) {
  if (!std::isfinite(value)) throw NumberNotFinite(what + " is not a finite number");
  return value == 0.0 ? "0" : rounded_value(0.0, value, what).expanded;
}

/// Contributions to the outputs from `first` to before `end`, all of one unit.
void add_contributions(XmlElement& list, const Wording& name, const BudgetLine& line, int first, int end,
                       const std::string& unit) {
  std::vector<std::string> labels, si, own;
  const UnitInDsi in = unit_in_dsi(unit);
  for (int k = first; k < end; ++k) {
    labels.emplace_back(output_symbol(k));
    si.push_back(two_digits(line.contribution(k) * in.factor, "contribution of " + line.input));
    own.push_back(two_digits(line.contribution(k), "contribution of " + line.input));
  }
  XmlElement quantity = list.add("dcc:quantity");
  quantity.attribute("refType", "abc_contribution");
  add_words(quantity, "dcc:name", name);
  if (!in.own) return add_number_list(quantity, labels, si, in.unit.text());
  XmlElement both = quantity.add("si:hybrid");
  add_number_list(both, labels, si, in.unit.text());
  for (std::string& label : labels) label += "[" + in.own->text() + "]";
  add_number_list(both, labels, own, in.own->text());
}

}  // namespace

void add_budget(XmlElement& results, const Words& words, const ReportData& data) {
  XmlElement result = results.add("dcc:result");
  result.attribute("refType", "abc_budget");
  add_words(result, "dcc:name", words("Uncertainty budget"));
  add_words(
      result, "dcc:description",
      words("To first order (JCGM 100): what each input contributes to the standard uncertainty of each "
            "output, per local gravity. The sum of squares is the square of the standard uncertainty."));
  XmlElement budget = result.add("dcc:data");
  for (const BudgetLine& line : data.budget->lines) {
    if (line.input == "g_loc") continue;  // Results per local gravity do not depend on it.
    XmlElement list = budget.add("dcc:list");
    list.attribute("refType", "abc_budgetLine");
    add_words(list, "dcc:name", input_words(words, line.input));
    add_words(list, "dcc:description",
              line.type_a ? words("type A, {}", words.known(line.distribution))
                          : words("type B, {}", words.known(line.distribution)));
    if (std::isfinite(line.standard_uncertainty)) {
      XmlElement input = list.add("dcc:quantity");
      input.attribute("refType", "abc_inputUncertainty");
      add_words(input, "dcc:name", words("standard uncertainty of the input"));
      const auto [unit, factor] = input_unit(line.unit);
      XmlElement real = input.add("si:real");
      real.add("si:value", two_digits(line.standard_uncertainty * factor, line.input));
      real.add("si:unit", unit);
    }
    add_contributions(list, words("contribution to sensitivities and offsets"), line, 0, kFirstIntrinsicAngle,
                      data.record.response_unit);
    add_contributions(list, words("contribution to angles"), line, kFirstIntrinsicAngle, kStudyOutputs,
                      "degree");
  }
}

}  // namespace abcal
