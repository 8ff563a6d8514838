#include "app/laboratory/certificate/dcc_quantity.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "app/formats/dsi_unit.h"
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

bool is_shown(ScopeMark mark) {
  return mark == ScopeMark::kRaised || mark == ScopeMark::kOutside;
}

/// Degrees of freedom below this are stated; k of more is that of a normal distribution to all its digits.
constexpr double kManyDegrees = 1000.0;

/// Degrees of freedom of each output, which uncertainties were raised to the scope's, and what is outside of
/// it.
void add_list_metadata(XmlElement& quantity, const Words& words, const ValueList& list) {
  std::vector<std::string> labels, degrees;
  for (Eigen::Index i = 0; i < list.values.size(); ++i) {
    const auto at = static_cast<std::size_t>(i);
    if (list.degrees_of_freedom[i] < kManyDegrees) {
      labels.push_back("nu(" + list.labels[at] + ")");
      degrees.push_back(fmt::format("{:.0f}", std::floor(list.degrees_of_freedom[i])));
    }
  }
  const bool marked = std::any_of(list.marks.begin(), list.marks.end(), is_shown);
  if (labels.empty() && !marked) return;
  XmlElement metadata = quantity.add("dcc:measurementMetaData");
  if (!labels.empty()) {
    XmlElement metadatum =
        add_metadatum(metadata, "abc_degreesOfFreedom", words("Effective degrees of freedom"));
    XmlElement data = metadatum.add("dcc:data");
    XmlElement of = add_quantity(data, "abc_degreesOfFreedom", words("Effective degrees of freedom"));
    add_number_list(of, labels, degrees, "\\one");
  }
  if (marked) add_scope_marks(metadata, words, list.labels, list.marks);
}

}  // namespace

void add_scope_marks(XmlElement& metadata, const Words& words, const std::vector<std::string>& labels,
                     const std::vector<ScopeMark>& marks) {
  const auto add = [&](ScopeMark mark, const char* ref_type, const Wording& name) {
    std::vector<std::string> marked;
    for (std::size_t i = 0; i < marks.size(); ++i)
      if (marks[i] == mark) marked.push_back(labels[i]);
    if (marked.empty()) return;
    XmlElement metadatum = add_metadatum(metadata, ref_type, name);
    add_text(metadatum, words.as_given(fmt::format("{}", fmt::join(marked, " "))));
  };
  add(ScopeMark::kRaised, kRaisedToScopeMark,
      words("U raised to the smallest of the laboratory's scope (CMC)"));
  add(ScopeMark::kOutside, kOutsideScopeMark, words("Outside the scope that the laboratory states"));
}

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
