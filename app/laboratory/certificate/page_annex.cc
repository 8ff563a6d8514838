#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "app/laboratory/certificate/dcc_state.h"
#include "app/laboratory/certificate/page_numbers.h"
#include "app/laboratory/certificate/page_parts.h"
#include "app/laboratory/certificate/scope.h"
#include "protocol/quantities/output_names.h"

namespace abcal {

std::string without_unit(const std::string& label) {
  return label.substr(0, label.find('['));
}

bool is_hybrid(const PageSource& from, xmlNode* quantity) {
  return from.xml.any("si:hybrid", quantity);
}

std::vector<PageValue> printed_values(const XmlQuery& xml, xmlNode* quantity, bool own) {
  const std::string at = xml.any("si:hybrid", quantity) ? (own ? "si:hybrid/*[last()]" : "si:hybrid/*[1]")
                                                        : "*[self::si:real or self::si:realListXMLList]";
  // A list and a single value differ in the ends of their elements' names only.
  const auto words_of = [&](const std::string& name) {
    const std::string element = "*[starts-with(local-name(), '" + name + "')]";
    std::vector<std::string> words = xml.words(at + "/" + element, quantity);
    if (words.empty()) words = xml.words(at + "/*/*/" + element, quantity);
    return words;
  };
  const std::vector<std::string> values = words_of("value"), labels = words_of("label"),
                                 units = words_of("unit"), expanded = words_of("valueExpandedMU"),
                                 factors = words_of("coverageFactor");
  const auto one_of = [&](const std::vector<std::string>& list, std::size_t i) {
    return list.empty() ? std::string() : list.size() == 1 ? list.front() : list.at(i);
  };
  std::vector<PageValue> all;
  for (std::size_t i = 0; i < values.size(); ++i) {
    PageValue value;
    value.xml_label = value.label = without_unit(one_of(labels, i));
    value.value = values[i];
    value.expanded = one_of(expanded, i);
    value.factor = one_of(factors, i);
    value.unit = one_of(units, i);
    all.push_back(std::move(value));
  }
  return all;
}

PageValue typeset(PageValue value, const Words& words) {
  if (const std::size_t star = value.label.find('*'); star != std::string::npos)
    value.label.replace(star, 1, "·");
  for (std::string* number : {&value.value, &value.expanded, &value.factor})
    *number = typeset_number(*number, words);
  value.unit = typeset_unit(value.unit);
  return value;
}

std::vector<PageValue> values_of(const PageSource& from, xmlNode* quantity, bool own) {
  std::vector<PageValue> all = printed_values(from.xml, quantity, own);
  for (PageValue& value : all) value = typeset(std::move(value), from.words);
  return all;
}

std::string quantity_words(const PageSource& from, std::string name) {
  // The axis or pair is the last word.
  const std::size_t last = name.rfind('_');
  if (last == std::string::npos) return name;
  const std::string axis = name.substr(last + 1);
  name.resize(last);
  std::replace(name.begin(), name.end(), '_', ' ');
  static constexpr Term kNames[]{"sensitivity",  "intrinsic sensitivity",  "intrinsic angle",
                                 "offset",       "transverse sensitivity", "transverse azimuth",
                                 "misalignment", "non orthogonality",      "bias"};
  return from.words(word_of(kNames, name)).text + " " + axis;
}

std::string symbol_or_words(const PageSource& from, const std::string& name) {
  const std::string axis = name.substr(name.rfind('_') + 1);
  for (const auto& [group, symbol] : {std::pair{"sensitivity_", "s_"},
                                      {"intrinsic_sensitivity_", "s_"},
                                      {"intrinsic_angle_", "phi_"},
                                      {"offset_", "O_"}})
    if (name == group + axis) return symbol + axis;
  return quantity_words(from, name);
}

std::vector<xmlNode*> quantities_of(const XmlQuery& xml, xmlNode* result) {
  return xml.nodes("dcc:data/dcc:quantity | dcc:data/dcc:list/dcc:quantity", result);
}

DocumentTable value_table(const PageSource& from) {
  DocumentTable table;
  table.columns = {{from.say("Quantity"), CellKind::kSymbol},
                   {from.say("Value"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {"k", CellKind::kNumber},
                   {"ν", CellKind::kNumber},
                   {from.say("Unit"), CellKind::kUnit}};
  return table;
}

std::map<std::string, std::string> degrees_of_freedom_of(const PageSource& from, xmlNode* quantity) {
  std::map<std::string, std::string> degrees;
  for (xmlNode* stated : from.xml.nodes(
           "dcc:measurementMetaData/dcc:metaData[@refType='abc_degreesOfFreedom']/dcc:data/dcc:quantity",
           quantity))
    for (const PageValue& value : values_of(from, stated)) degrees[value.label] = value.value;
  return degrees;
}

bool is_marked(const XmlQuery& xml, xmlNode* quantity, const std::string& mark, const std::string& label) {
  for (const std::string& labels : xml.texts(
           "dcc:measurementMetaData/dcc:metaData[@refType='" + mark + "']/dcc:data/dcc:text/dcc:content",
           quantity))
    for (const std::string& marked : xml_words(labels))
      if (label.empty() || marked == label) return true;
  return false;
}

std::string scope_star(const PageSource& from, xmlNode* quantity, const std::string& label) {
  return is_marked(from.xml, quantity, kOutsideScopeMark, label) ? " *" : "";
}

void add_value_rows(DocumentTable& table, const PageSource& from, xmlNode* quantity, bool own,
                    bool in_words) {
  const std::map<std::string, std::string> degrees = degrees_of_freedom_of(from, quantity);
  for (const PageValue& value : values_of(from, quantity, own)) {
    const std::string star = scope_star(from, quantity, value.xml_label);
    const auto nu = degrees.find("nu(" + value.label + ")");
    table.rows.push_back({(in_words ? quantity_words(from, value.label) : value.label) + star, value.value,
                          value.expanded, value.factor, nu == degrees.end() ? "∞" : nu->second, value.unit});
  }
}

void add_rows(DocumentTable& table, const PageSource& from, xmlNode* result, bool own, bool in_words) {
  table.rows.push_back({from.content("dcc:name", result)});
  for (xmlNode* quantity : quantities_of(from, result)) add_value_rows(table, from, quantity, own, in_words);
}

namespace {

/// Results that no page has yet, but for those with a form of their own.
Section remaining_results(const PageSource& from, xmlNode* measurement,
                          const std::vector<std::string>& shown) {
  static const std::array<std::string_view, 11> kElsewhere{"abc_sensitivityMatrix",
                                                           "abc_intrinsicSensitivities",
                                                           "abc_intrinsicAngles",
                                                           "abc_offsets",
                                                           "abc_conformity",
                                                           "abc_shift",
                                                           kStateType,
                                                           "abc_budget",
                                                           "abc_noResult",
                                                           "abc_customerEquation",
                                                           "abc_responseAtRates"};
  DocumentTable table = value_table(from);
  table.may_break = true;
  for (xmlNode* result : from.xml.nodes("dcc:results/dcc:result", measurement)) {
    const std::string ref_type = owned_text(xmlGetProp(result, as_xml("refType")));
    if (std::find(kElsewhere.begin(), kElsewhere.end(), ref_type) != kElsewhere.end()) continue;
    if (std::find(shown.begin(), shown.end(), ref_type) != shown.end()) continue;
    // The list of all outputs repeats the lists before it; its covariance is shown below.
    if (ref_type == "abc_allOutputsPerGravity") continue;
    add_rows(table, from, result, true,
             ref_type.find("ensitivit") == std::string::npos || ref_type == "abc_transverseSensitivity" ||
                 ref_type.starts_with("abc_sensitivityInUnit"));
  }
  Section section{from.say("Further results"), {}};
  if (!table.rows.empty()) section.blocks.emplace_back(std::move(table));
  return section;
}

/// Uncertainties that were raised to the smallest of the laboratory's scope.
Section raised_section(const PageSource& from, xmlNode* measurement) {
  FactList list;
  for (xmlNode* raised : from.xml.nodes(
           fmt::format("dcc:results//dcc:metaData[@refType='{}']", kRaisedToScopeMark), measurement))
    list.facts.emplace_back(
        from.content("../../dcc:name", raised),
        from.content("dcc:name", raised) + ": " + from.content("dcc:data/dcc:text", raised));
  Section section{from.say("Uncertainties raised to the laboratory's scope"), {}};
  if (!list.facts.empty()) section.blocks.emplace_back(std::move(list));
  return section;
}

Section method_section(const PageSource& from, xmlNode* measurement) {
  FactList list;
  DocumentTable effects;
  effects.may_break = true;
  effects.columns = {{from.say("Effect")},
                     {from.say("Standard uncertainty"), CellKind::kNumber},
                     {from.say("Unit"), CellKind::kUnit},
                     {from.say("Source")}};
  for (xmlNode* method : from.xml.nodes("dcc:usedMethods/dcc:usedMethod", measurement)) {
    std::string text = from.content("dcc:description", method);
    for (const std::string& line : from.xml.texts("dcc:norm | dcc:reference", method))
      text += " " + line + ".";
    for (xmlNode* quantity : from.xml.nodes("dcc:usedMethodQuantities/dcc:usedMethodQuantity", method)) {
      const PageValue value = values_of(from, quantity).front();
      if (owned_text(xmlGetProp(quantity, as_xml("refType"))) == "abc_effect") {
        effects.rows.push_back({from.content("dcc:name", quantity), value.value, value.unit,
                                from.content("dcc:description", quantity)});
      } else {
        text += " " + from.content("dcc:name", quantity) + ": " + value.value +
                (value.unit == "1" ? "" : " " + value.unit) + ".";
      }
    }
    list.facts.emplace_back(from.content("dcc:name", method), text);
  }
  Section section{from.say("Method"), {list}};
  if (!effects.rows.empty()) {
    effects.caption = from.say("Effects in the uncertainties, and where their sizes come from");
    section.blocks.emplace_back(std::move(effects));
  }
  return section;
}

/// Contributions of one line of the budget: label, and the digits of the XML.
std::map<std::string, std::string> contributions_of(const PageSource& from, xmlNode* line) {
  std::map<std::string, std::string> all;
  for (xmlNode* quantity : from.xml.nodes("dcc:quantity[@refType='abc_contribution']", line)) {
    const auto labels = from.xml.words("si:realListXMLList/si:labelXMLList", quantity),
               values = from.xml.words("si:realListXMLList/si:valueXMLList", quantity);
    for (std::size_t i = 0; i < labels.size() && i < values.size(); ++i) all.emplace(labels[i], values[i]);
  }
  return all;
}

/// For each kind of output, the one with the largest uncertainty.
std::vector<std::string> worst_outputs(const std::vector<std::map<std::string, std::string>>& lines) {
  std::map<std::string, double> squares;
  for (const auto& line : lines)
    for (const auto& [label, value] : line) squares[label] += std::pow(number_in_xml(value), 2);
  // For each three of kOutputSymbols the place of their kind: matrix (nine), intrinsic s, O, phi; then
  // others.
  constexpr std::array kPlaceOfKind{0, 0, 0, 2, 1, 3, 4};
  std::map<int, std::pair<double, std::string>> worst;
  for (const auto& [label, sum] : squares) {
    const auto symbol = std::ranges::find(kOutputSymbols, label);
    auto& best = worst[kPlaceOfKind.at(static_cast<std::size_t>(symbol - kOutputSymbols.begin()) / 3)];
    if (best.second.empty() || sum > best.first) best = {sum, label};
  }
  std::vector<std::string> labels;
  for (const auto& [kind, best] : worst) labels.push_back(best.second);
  return labels;
}

/// Degrees of freedom of a line's contributions to these outputs: one number, or the least and the most.
std::string degrees_of(const PageSource& from, xmlNode* line, const std::vector<std::string>& outputs) {
  const std::map<std::string, std::string> known = degrees_of_freedom_of(from, line);
  std::string least, most;
  for (const std::string& output : outputs) {
    const auto found = known.find("nu(" + output + ")");
    if (found == known.end()) continue;
    const double value = number_in_xml(found->second);
    if (least.empty() || value < number_in_xml(least)) least = found->second;
    if (most.empty() || value > number_in_xml(most)) most = found->second;
  }
  if (least.empty()) return "∞";
  return least == most ? least : from.words("{from} to {to}", least, most).text;
}

/// The sources of a budget, each with its inputs.
FactList sources_of(const PageSource& from, const std::vector<xmlNode*>& lines) {
  FactList list;
  for (xmlNode* line : lines) {
    const std::string source =
        from.content("dcc:measurementMetaData/dcc:metaData[@refType='abc_source']/dcc:data/dcc:text", line);
    if (source.empty()) continue;  // A certificate of an earlier version.
    const std::string name = from.say("Source") + ": " + source, input = from.content("dcc:name", line);
    const auto known = std::find_if(list.facts.begin(), list.facts.end(),
                                    [&](const auto& fact) { return fact.first == name; });
    if (known == list.facts.end()) {
      list.facts.emplace_back(name, input);
    } else {
      known->second += "; " + input;
    }
  }
  return list;
}

Section budget_section(const PageSource& from, xmlNode* measurement) {
  Section section{from.say("Uncertainty budget"), {}};
  const auto results = from.xml.nodes("dcc:results/dcc:result[@refType='abc_budget']", measurement);
  if (results.empty()) return section;
  const auto lines = from.xml.nodes("dcc:data/dcc:list", results.front());
  std::vector<std::map<std::string, std::string>> contributions;
  for (xmlNode* line : lines) contributions.push_back(contributions_of(from, line));
  const std::vector<std::string> outputs = worst_outputs(contributions);
  DocumentTable table;
  table.may_break = true;
  table.columns = {{from.say("Input")},
                   {from.say("Kind"), CellKind::kUnit},
                   {"ν", CellKind::kNumber},
                   {"u", CellKind::kNumber},
                   {from.say("Unit"), CellKind::kUnit}};
  for (const std::string& output : outputs) table.columns.push_back({output, CellKind::kNumber});
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const auto inputs = from.xml.nodes("dcc:quantity[@refType='abc_inputUncertainty']", lines[i]);
    const PageValue input = inputs.empty() ? PageValue{} : values_of(from, inputs.front()).front();
    std::vector<std::string> row{from.content("dcc:name", lines[i]),
                                 from.content("dcc:description", lines[i]),
                                 degrees_of(from, lines[i], outputs), input.value, input.unit};
    for (const std::string& output : outputs) {
      const auto found = contributions[i].find(output);
      row.push_back(found == contributions[i].end() ? "" : typeset_number(found->second, from.words));
    }
    table.rows.push_back(std::move(row));
  }
  section.blocks.push_back(Paragraph{
      from.content("dcc:description", results.front()) + " " +
      from.say("Shown are the outputs with the largest uncertainty of each kind; the XML has all.")});
  section.blocks.emplace_back(std::move(table));
  if (FactList sources = sources_of(from, lines); !sources.facts.empty())
    section.blocks.emplace_back(std::move(sources));
  return section;
}

Section instrument_section(const PageSource& from, xmlNode* measurement) {
  DocumentTable table;
  table.may_break = true;
  table.columns = {{from.say("Equipment")},
                   {from.say("Manufacturer")},
                   {from.say("Type")},
                   {from.say("Serial number")},
                   {from.say("Description")}};
  for (xmlNode* one : from.xml.nodes("dcc:measuringEquipments/dcc:measuringEquipment", measurement)) {
    table.rows.push_back(
        {from.content("dcc:name", one), from.content("dcc:manufacturer/dcc:name", one),
         from.text("dcc:model", one),
         from.text("dcc:identifications/dcc:identification[dcc:issuer='manufacturer']/dcc:value", one),
         from.content("dcc:description", one)});
  }
  return {from.say("Equipment"), {table}};
}

/// Statements that are not on the customer's pages: units, marks, sources that the uncertainties exclude.
Section further_statements(const PageSource& from) {
  FactList list;
  for (xmlNode* statement : from.xml.nodes("dcc:administrativeData/dcc:statements/dcc:statement")) {
    const std::string ref_type = owned_text(xmlGetProp(statement, as_xml("refType")));
    static const std::array<std::string_view, 10> kHere{
        "abc_draft", "abc_training",   "abc_simulated",  "abc_replayed",     "abc_traceability",
        "abc_unit",  "abc_notCovered", "abc_outputUnit", "abc_decisionRule", "abc_runs"};
    if (std::find(kHere.begin(), kHere.end(), ref_type) == kHere.end()) continue;
    std::string text = from.sentences("dcc:declaration", statement);
    for (const std::string& line : from.xml.texts("dcc:norm | dcc:reference", statement))
      text += " " + line + ".";
    list.facts.emplace_back(from.content("dcc:name", statement), text);
  }
  return {from.say("Further statements"), {list}};
}

Section record_section(const PageSource& from, xmlNode* measurement) {
  FactList list;
  for (xmlNode* metadata : from.xml.nodes("dcc:measurementMetaData/dcc:metaData", measurement)) {
    const std::string text = from.sentences("dcc:data/dcc:text", metadata);
    list.facts.emplace_back(from.content("dcc:name", metadata),
                            text.empty() ? from.sentences("dcc:description", metadata) : text);
  }
  for (xmlNode* software : from.xml.nodes("dcc:usedSoftware/dcc:software", measurement))
    list.facts.emplace_back(from.content("dcc:name", software), from.content("dcc:description", software));
  for (xmlNode* quantity : from.xml.nodes("dcc:administrativeData/dcc:items/dcc:item/dcc:itemQuantities/"
                                          "dcc:itemQuantity[@refType='abc_setting']"))
    list.facts.emplace_back(from.content("dcc:name", quantity), from.content("dcc:noQuantity", quantity));
  return {from.say("Record"), {list}};
}

}  // namespace

std::vector<Section> annex_sections(const PageSource& from, xmlNode* measurement,
                                    const std::vector<std::string>& shown) {
  std::vector<Section> all;
  for (Section& section : std::array{remaining_results(from, measurement, shown),
                                     raised_section(from, measurement), method_section(from, measurement),
                                     budget_section(from, measurement), instrument_section(from, measurement),
                                     further_statements(from), record_section(from, measurement)})
    if (!section.blocks.empty()) all.push_back(std::move(section));
  return all;
}

}  // namespace abcal
