#include "app/laboratory/certificate/business_rules.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <functional>
#include <regex>
#include <set>

#include "app/formats/xml_query.h"
#include "app/laboratory/certificate/iso_codes.h"
#include "app/laboratory/certificate/laboratory_file.h"

namespace abcal {
namespace {

class Rules {
 public:
  explicit Rules(xmlDoc* document) : select_(document) {}

  std::vector<DccProblem> check() {
    check_version();
    check_everything_declared();
    check_nothing_empty();
    check_ids();
    check_languages();
    check_codes();
    check_dates();
    check_releases();
    check_units();
    check_lists();
    check_non_si();
    check_numbers();
    return std::move(problems_);
  }

 private:
  void add(xmlNode* node, std::string what) {
    problems_.push_back({owned_text(xmlGetNodePath(node)), std::move(what)});
  }

  /// Each node of `path` must be good.
  void each(const char* path, const std::function<bool(xmlNode*)>& good,
            const std::function<std::string(xmlNode*)>& what) {
    for (xmlNode* node : select_.nodes(path))
      if (!good(node)) add(node, what(node));
  }

  void check_version() {
    each(
        "/dcc:digitalCalibrationCertificate",
        [this](xmlNode* node) { return select_.any("self::*[@schemaVersion='3.3.0']", node); },
        [](xmlNode*) { return std::string("schemaVersion is not 3.3.0"); });
  }

  /// Methods and conditions: for the whole measurement, for the list, or for every quantity.
  void check_everything_declared() {
    for (const std::string element : {"dcc:usedMethods", "dcc:influenceConditions"}) {
      const std::string lists = fmt::format(
          "//dcc:measurementResults//dcc:list[not(ancestor::dcc:metaData)][not({0}) and "
          "not(ancestor::dcc:measurementResult/{0}) and count(dcc:quantity) > count(dcc:quantity/{0})]",
          element);
      const std::string quantities = fmt::format(
          "//dcc:result/dcc:data/dcc:quantity[not({0}) and not(ancestor::dcc:measurementResult/{0})]",
          element);
      for (const std::string& path : {lists, quantities})
        for (xmlNode* node : select_.nodes(path))
          add(node, element + " are missing: neither here nor for the whole measurement");
    }
  }

  /// Signatures are excepted: their standard has empty elements.
  void check_nothing_empty() {
    for (const char* path : {"//dcc:*[not(*)][not(self::dcc:metaData)]", "//si:*[not(*)]"}) {
      each(
          path, [](xmlNode* node) { return !xml_words(xml_content(node)).empty(); },
          [](xmlNode*) { return std::string("empty, or blanks only"); });
    }
  }

  void check_ids() {
    std::set<std::string> ids, referred;
    for (xmlNode* id : select_.nodes("//@id")) ids.insert(xml_content(id));
    for (xmlNode* reference : select_.nodes("//@refId")) {
      for (const std::string& word : xml_words(xml_content(reference))) {
        referred.insert(word);
        if (!ids.contains(word)) add(reference, "refId \"" + word + "\" is no id of this certificate");
      }
    }
    for (xmlNode* id : select_.nodes("//@id"))
      if (!referred.contains(xml_content(id)))
        add(id, "id \"" + xml_content(id) + "\" is referred to by no refId");
  }

  void check_languages() {
    std::set<std::string> used;
    for (xmlNode* node : select_.nodes("//dcc:usedLangCodeISO639_1"))
      if (!used.insert(xml_content(node)).second)
        add(node, "language \"" + xml_content(node) + "\" is declared twice");
    for (xmlNode* parent : select_.nodes("//*[dcc:content[@lang]]")) {
      std::set<std::string> here;
      for (xmlNode* lang : select_.nodes("dcc:content/@lang", parent)) {
        const std::string code = xml_content(lang);
        if (!used.contains(code)) add(lang, "language \"" + code + "\" is not declared");
        if (!here.insert(code).second) add(lang, "language \"" + code + "\" appears twice");
      }
      for (const std::string& code : used)
        if (!here.contains(code)) add(parent, "no text in the declared language \"" + code + "\"");
    }
  }

  void check_codes() {
    for (const char* path : {"//dcc:usedLangCodeISO639_1", "//dcc:mandatoryLangCodeISO639_1"}) {
      each(
          path, [](xmlNode* node) { return is_language_code(xml_content(node)); },
          [](xmlNode* node) { return "\"" + xml_content(node) + "\" is no language code of ISO 639-1"; });
    }
    for (const char* path : {"//dcc:countryCodeISO3166_1", "//dcc:countryCode"}) {
      each(
          path, [](xmlNode* node) { return is_country_code(xml_content(node)); },
          [](xmlNode* node) { return "\"" + xml_content(node) + "\" is no country code of ISO 3166-1"; });
    }
  }

  void check_dates() {
    for (xmlNode* end : select_.nodes("//dcc:coreData/dcc:endPerformanceDate")) {
      for (xmlNode* begin : select_.nodes("../dcc:beginPerformanceDate", end)) {
        const auto from = parse_date(xml_content(begin)), to = parse_date(xml_content(end));
        if (!from || !to || *to < *from)
          add(end, fmt::format("ends on {}, before it begins on {}", xml_content(end), xml_content(begin)));
      }
    }
  }

  void check_releases() {
    static const std::regex kRelease("^[a-zA-Z] ?([0-9]{1,3}\\.){0,3}[0-9]{1,3}$");
    each(
        "//dcc:release", [](xmlNode* node) { return std::regex_match(xml_content(node), kRelease); },
        [](xmlNode* node) {
          return "release \"" + xml_content(node) + "\"; required: a letter and numbers, \"v1.2.3\"";
        });
  }

  void check_units() {
    each(
        "//si:unit", [](xmlNode* node) { return xml_content(node).find(' ') == std::string::npos; },
        [](xmlNode* node) { return "blanks in the unit \"" + xml_content(node) + "\""; });
    for (xmlNode* units : select_.nodes("//si:unitXMLList")) {
      const std::vector<std::string> words = xml_words(xml_content(units));
      if (words.size() < 2) continue;
      for (xmlNode* values : select_.nodes("preceding-sibling::si:valueXMLList", units)) {
        const std::size_t count = xml_words(xml_content(values)).size();
        if (count != words.size()) add(units, fmt::format("{} units for {} values", words.size(), count));
      }
      if (std::count(words.begin(), words.end(), words.front()) == static_cast<std::ptrdiff_t>(words.size()))
        add(units, "the same unit is repeated; required: one unit for the list");
    }
  }

  /// One blank between entries and none at the ends; as many entries as values, or one.
  void check_lists() {
    const auto well_spaced = [](xmlNode* node) {
      const std::string text = xml_content(node);
      return !text.empty() && std::string(" \t\r\n").find(text.front()) == std::string::npos &&
             std::string(" \t\r\n").find(text.back()) == std::string::npos &&
             std::adjacent_find(text.begin(), text.end(), [](char a, char b) {
               return std::isspace(static_cast<unsigned char>(a)) != 0 &&
                      std::isspace(static_cast<unsigned char>(b)) != 0;
             }) == text.end();
    };
    const auto what = [](xmlNode*) {
      return std::string("required: one blank between entries, none at the ends");
    };
    each("//si:*[substring(local-name(), string-length(local-name()) - 6) = 'XMLList'][not(*)]", well_spaced,
         what);
    each("//@refType | //@refId", well_spaced, what);
    for (xmlNode* list : select_.nodes("//si:realListXMLList")) {
      const std::vector<xmlNode*> values = select_.nodes("si:valueXMLList", list);
      if (values.empty()) continue;
      const std::size_t count = xml_words(xml_content(values.front())).size();
      for (xmlNode* other : select_.nodes("si:labelXMLList | si:measurementUncertaintyUnivariateXMLList/*/* "
                                          "| .//si:covarianceXMLList/si:valueXMLList",
                                          list)) {
        const std::size_t found = xml_words(xml_content(other)).size();
        if (found != count && found != 1) add(other, fmt::format("{} entries for {} values", found, count));
      }
      const std::size_t columns = select_.nodes(".//si:columnXMLList", list).size();
      if (columns != 0 && columns != count)
        add(list, fmt::format("{} columns of covariance for {} values", columns, count));
    }
  }

  void check_non_si() {
    std::set<std::string> declared;
    for (xmlNode* unit : select_.nodes("//dcc:statement/dcc:nonSIUnit")) declared.insert(xml_content(unit));
    each(
        "//si:hybrid/si:real/si:unit",
        [&](xmlNode* node) {
          const std::string unit = xml_content(node);
          return unit.size() < 2 || unit.front() != '|' || declared.contains(unit);
        },
        [](xmlNode* node) { return "unit \"" + xml_content(node) + "\" is declared by no statement"; });
    for (const char* path : {"//*[dcc:nonSIUnit and not(dcc:nonSIDefinition)]",
                             "//*[dcc:nonSIDefinition and not(dcc:nonSIUnit)]"}) {
      each(
          path, [](xmlNode*) { return false; },
          [](xmlNode*) { return std::string("nonSIUnit and nonSIDefinition go together"); });
    }
  }

  /// Refuses a certificate without numbers: NaN, which the schema would accept.
  void check_numbers() {
    each(
        "//si:*[not(*)]",
        [](xmlNode* node) {
          const std::vector<std::string> words = xml_words(xml_content(node));
          return std::find(words.begin(), words.end(), "NaN") == words.end() ||
                 std::string(reinterpret_cast<const char*>(node->name)).starts_with("label");
        },
        [](xmlNode*) { return std::string("NaN instead of a number"); });
  }

  XmlQuery select_;
  std::vector<DccProblem> problems_;
};

}  // namespace

std::vector<DccProblem> check_business_rules(const XmlDocument& document) {
  return Rules(document.get()).check();
}

std::string to_string(const std::vector<DccProblem>& problems) {
  std::string text;
  for (const DccProblem& problem : problems) text += fmt::format("\n  {}: {}", problem.where, problem.what);
  return text;
}

}  // namespace abcal
