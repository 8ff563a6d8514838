#include "app/laboratory/certificate/certificate_json.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>

#include "app/laboratory/certificate/dcc_state.h"
#include "app/laboratory/certificate/page_numbers.h"
#include "app/laboratory/certificate/page_parts.h"
#include "app/laboratory/certificate/scope.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

Json text_or_null(const std::string& text) {
  return text.empty() ? Json(nullptr) : Json(text);
}

/// A number in the digits of the XML.
Json number_or_null(const std::string& text) {
  const double value = number_in_xml(text);
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

std::string ref_type_of(xmlNode* node) {
  return owned_text(xmlGetProp(node, as_xml("refType")));
}

void add_statements(Json& list, const PageSource& from, xmlNode* quantity) {
  const XmlQuery& xml = from.xml;
  const std::string name = xml.text("dcc:name/dcc:content", quantity),
                    conformity = xml.text(
                        "dcc:measurementMetaData/dcc:metaData[@refType='basic_conformity']/dcc:conformity",
                        quantity);
  const std::size_t forms = xml.any("si:hybrid", quantity) ? 2 : 1;
  for (std::size_t form = 0; form < forms; ++form) {
    for (const PageValue& value : printed_values(xml, quantity, form > 0)) {
      const PageValue printed = typeset(value, from.words);
      const auto mark = [&](const char* ref_type) {
        return is_marked(xml, quantity, ref_type, value.xml_label);
      };
      list.push_back({{"name", name},
                      {"quantity", value.xml_label.empty() ? name : value.xml_label},
                      {"value", number_or_null(value.value)},
                      {"unit", value.unit},
                      {"expanded_uncertainty", number_or_null(value.expanded)},
                      {"coverage_factor", number_or_null(value.factor)},
                      {"conformity", text_or_null(conformity)},
                      {"scope", mark(kOutsideScopeMark)    ? Json("outside")
                                : mark(kRaisedToScopeMark) ? Json("raised")
                                                           : Json(nullptr)},
                      {"printed",
                       {{"value", printed.value},
                        {"expanded_uncertainty", text_or_null(printed.expanded)},
                        {"coverage_factor", text_or_null(printed.factor)},
                        {"unit", printed.unit}}}});
    }
  }
}

/// Results whose numbers belong to those of others.
bool belongs_to_others(std::string_view ref_type) {
  return ref_type == kStateType || ref_type == "abc_budget";
}

}  // namespace

nlohmann::ordered_json certificate_json(const std::string& xml) {
  const XmlDocument parsed = parse_xml(xml, "certificate");
  const XmlQuery query(parsed.get());
  const std::string core = "dcc:administrativeData/dcc:coreData/";
  const PageSource from{query, Words(query.text(core + "dcc:usedLangCodeISO639_1"))};
  Json json;
  json["number"] = query.text(core + "dcc:uniqueIdentifier");
  json["issued"] = text_or_null(query.text(core + "dcc:issueDate"));
  json["monte_carlo"] = text_or_null(query.text(
      "dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_monteCarlo']/dcc:declaration/"
      "dcc:content"));
  json["results"] = Json::array();
  for (xmlNode* measurement : query.nodes("dcc:measurementResults/dcc:measurementResult")) {
    const std::string calibration = query.text("dcc:name/dcc:content", measurement);
    for (xmlNode* result : query.nodes("dcc:results/dcc:result", measurement)) {
      const std::string ref_type = ref_type_of(result);
      if (belongs_to_others(ref_type)) continue;
      Json statements = Json::array();
      for (xmlNode* quantity : quantities_of(query, result)) add_statements(statements, from, quantity);
      json["results"].push_back({{"calibration", calibration},
                                 {"result", ref_type},
                                 {"name", query.text("dcc:name/dcc:content", result)},
                                 {"statements", std::move(statements)}});
    }
  }
  return json;
}

}  // namespace abcal
