#include "app/laboratory/certificate/dcc_quantity.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <charconv>
#include <cmath>

#include "app/ground/units/dsi_unit.h"
#include "app/laboratory/certificate/dcc_text.h"

namespace abcal {

XmlElement add_result(XmlElement& results, const std::string& ref_type, const Wording& name,
                      const Wording& description) {
  XmlElement result = results.add("dcc:result");
  result.attribute("refType", ref_type);
  add_words(result, "dcc:name", name);
  if (!description.text.empty()) add_words(result, "dcc:description", description);
  return result.add("dcc:data");
}

XmlElement add_quantity(XmlElement& parent, const std::string& ref_type, const Wording& name) {
  XmlElement quantity = parent.add("dcc:quantity");
  quantity.attribute("refType", ref_type);
  add_words(quantity, "dcc:name", name);
  return quantity;
}

namespace {

/// Degrees of freedom below this are stated; k of more is that of a normal distribution to all its digits.
constexpr double kManyDegrees = 1000.0;

/// Degrees of freedom of each output, and which uncertainties were raised to the scope's.
void add_list_metadata(XmlElement& quantity, const Words& words, const ValueList& list) {
  std::vector<std::string> labels, degrees, raised;
  std::vector<std::string> calculated;
  for (Eigen::Index i = 0; i < list.values.size(); ++i) {
    const auto at = static_cast<std::size_t>(i);
    if (list.degrees_of_freedom[i] < kManyDegrees) {
      labels.push_back("nu(" + list.labels[at] + ")");
      degrees.push_back(fmt::format("{:.0f}", std::floor(list.degrees_of_freedom[i])));
    }
    const double own = list.coverage_factor[i] * list.standard_uncertainty[i];
    if (!list.cmc.empty() && certified_uncertainty(own, list.cmc[at]).raised) {
      raised.push_back("U(" + list.labels[at] + ")");
      calculated.push_back(rounded_value(0.0, own, list.labels[at]).expanded);
    }
  }
  if (labels.empty() && raised.empty()) return;
  XmlElement metadata = quantity.add("dcc:measurementMetaData");
  if (!labels.empty()) {
    XmlElement metadatum =
        add_metadatum(metadata, "abc_degreesOfFreedom", words("Effective degrees of freedom"));
    XmlElement data = metadatum.add("dcc:data");
    XmlElement of = add_quantity(data, "abc_degreesOfFreedom", words("Effective degrees of freedom"));
    add_number_list(of, labels, degrees, "\\one");
  }
  if (raised.empty()) return;
  XmlElement metadatum = add_metadatum(metadata, "abc_raisedToScope",
                                       words("U raised to the smallest of the laboratory's scope (CMC)"));
  add_text(metadatum, words("As computed, in {}: {}", list.unit,
                            fmt::format("{} = {}", fmt::join(raised, ", "), fmt::join(calculated, ", "))));
}

}  // namespace

XmlElement add_list(XmlElement& parent, const Words& words, const Wording& name, const ValueList& list) {
  XmlElement quantity = add_quantity(parent, "basic_measuredValue", name);
  add_value_list(quantity, list);
  add_list_metadata(quantity, words, list);
  return quantity;
}

void add_number(XmlElement& data, const std::string& ref_type, const Wording& name, const std::string& number,
                const std::string& unit) {
  XmlElement quantity = add_quantity(data, ref_type, name);
  const auto add_real = [&](XmlElement& parent, const std::string& text, const DsiUnit& of) {
    XmlElement real = parent.add("si:real");
    real.add("si:value", text);
    real.add("si:unit", of.text());
  };
  const UnitInDsi in = unit_in_dsi(unit);
  if (!in.own) return add_real(quantity, number, in.unit);
  XmlElement both = quantity.add("si:hybrid");
  double value = 0.0;
  std::from_chars(number.data(), number.data() + number.size(), value);
  add_real(both, dsi_number(value * in.factor, name.text), in.unit);
  add_real(both, number, *in.own);
}

}  // namespace abcal
