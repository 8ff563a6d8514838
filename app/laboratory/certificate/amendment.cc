#include "app/laboratory/certificate/amendment.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <map>
#include <set>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/formats/xml_query.h"
#include "app/laboratory/certificate/dcc_state.h"
#include "drivers/text/names.h"

namespace abcal {
namespace {

constexpr auto kKinds = names<AmendmentKind>(
    {{AmendmentKind::kAdministrative, "administrative"}, {AmendmentKind::kTechnical, "technical"}});
constexpr std::string_view kCore = "administrativeData/coreData/";

/// Parts that differ in every certificate.
constexpr std::array<std::string_view, 7> kOwn{"administrativeData/coreData/uniqueIdentifier",
                                               "administrativeData/coreData/issueDate",
                                               "administrativeData/coreData/reportAmendedSubstituted",
                                               "administrativeData/coreData/previousReport",
                                               "administrativeData/statements/statement[abc_amendment]",
                                               "administrativeData/statements/statement[abc_register]",
                                               "Signature"};

/// Parts that an administrative amendment may change. The language is none of them: texts in two languages
/// cannot be compared, so that nobody knows whether a translation says the same of the item.
constexpr std::array<std::string_view, 8> kMayChange{"administrativeData/customer",
                                                     "administrativeData/calibrationLaboratory",
                                                     "administrativeData/respPersons",
                                                     "administrativeData/dccSoftware",
                                                     "administrativeData/coreData/identifications",
                                                     "administrativeData/coreData/receiptDate",
                                                     "administrativeData/coreData/countryCodeISO3166_1",
                                                     "administrativeData/statements/statement[abc_witness]"};

template <std::size_t N>
bool begins_with_one(std::string_view key, const std::array<std::string_view, N>& parts) {
  return std::any_of(parts.begin(), parts.end(), [&](std::string_view part) {
    return key == part || (key.starts_with(part) && (key[part.size()] == '/' || key[part.size()] == '#'));
  });
}

bool is_administrative(std::string_view key) {
  // The customer's address stands below the date of recalibration as well, and the program's version below
  // each result.
  return begins_with_one(key, kMayChange) || key.find("/respAuthority/") != std::string_view::npos ||
         key.find("/usedSoftware/") != std::string_view::npos;
}

std::string_view local_name(const xmlNode* node) {
  return reinterpret_cast<const char*>(node->name);
}

std::string attribute_of(xmlNode* node, const char* name) {
  return owned_text(xmlGetProp(node, as_xml(name)));
}

std::vector<xmlNode*> children_of(xmlNode* node) {
  std::vector<xmlNode*> list;
  for (xmlNode* child = node->children; child != nullptr; child = child->next)
    if (child->type == XML_ELEMENT_NODE) list.push_back(child);
  return list;
}

std::string text_of(xmlNode* node) {
  return one_line(xml_content(node));
}

/// The name of an element as its child "name" states it; empty: it has none.
std::string stated_name(xmlNode* node) {
  for (xmlNode* child : children_of(node))
    if (local_name(child) == "name" && child->children != nullptr) {
      const std::vector<xmlNode*> contents = children_of(child);
      return text_of(contents.empty() ? child : contents.front());
    }
  return {};
}

/// "valueExpandedMUXMLList" as "U".
std::string symbol_of(std::string_view element) {
  if (element.starts_with("valueExpandedMU")) return "U";
  if (element.starts_with("valueStandardMU")) return "u";
  if (element.starts_with("coverageFactor")) return "k";
  if (element.starts_with("coverageProbability")) return "p";
  constexpr std::string_view kList = "XMLList";
  if (element.ends_with(kList)) element.remove_suffix(kList.size());
  return std::string(element);
}

class Reader {
 public:
  std::vector<CertificateStatement> read(xmlNode* root) {
    read_children(root, {}, {});
    return std::move(statements_);
  }

 private:
  using Names = std::vector<std::string>;

  void add(const std::string& key, const Names& names, const std::string& last, std::string text,
           bool in_language = false) {
    if (text.empty() || begins_with_one(key, kOwn)) return;
    std::string name;
    for (const std::string& part : names)
      if (name.find(part) == std::string::npos) name += (name.empty() ? "" : ", ") + part;
    if (!last.empty()) name += (name.empty() ? "" : ", ") + last;
    statements_.push_back({key, std::move(name), std::move(text), is_administrative(key), in_language});
    if (key.find("/results/") == std::string::npos) return;
    // "g_loc*s_ux[|g]" is s_ux; the state repeats all of them for programs.
    const std::string of = last.substr(0, last.find('['));
    statements_.back().quantity = key.find(kStateType) != std::string::npos ? "covariance"
                                  : of.starts_with("g_loc*")                ? of.substr(6)
                                                                            : of;
  }

  void read_children(xmlNode* node, const std::string& key, const Names& names) {
    std::map<std::string, int> count;
    for (xmlNode* child : children_of(node)) {
      std::string step(local_name(child));
      if (const std::string type = attribute_of(child, "refType"); !type.empty()) step += "[" + type + "]";
      if (const int number = ++count[step]; number > 1) step += fmt::format("#{}", number);
      read_element(child, key.empty() ? step : key + "/" + step, names);
    }
  }

  void read_element(xmlNode* node, const std::string& key, const Names& names) {
    const std::string_view name = local_name(node);
    const std::vector<xmlNode*> children = children_of(node);
    if (name == "realListXMLList" || name == "real") return read_numbers(node, key, names);
    if (children.empty()) {
      const bool is_text = name == "content" || name == "name";
      return add(key, names, is_text && !names.empty() ? "" : std::string(name), text_of(node),
                 !attribute_of(node, "lang").empty());
    }
    Names own = names;
    if (const std::string stated = stated_name(node); !stated.empty())
      own.push_back(stated);
    else if (names.empty() || name == "location")
      if (key.find('/') != std::string::npos) own.emplace_back(name);
    read_children(node, key, own);
  }

  /// One statement for each number of a list, with its unit and its uncertainty.
  void read_numbers(xmlNode* node, const std::string& key, const Names& names) {
    std::vector<std::string> labels, texts;
    std::vector<std::pair<std::string, std::vector<std::string>>> parts;
    gather(node, key, names, parts);
    for (const auto& [element, words] : parts) {
      if (element.starts_with("label")) labels = words;
      if (element == "value" || element == "valueXMLList") texts = words;
    }
    const auto at = [&](const std::vector<std::string>& words, std::size_t i) {
      return words.size() == texts.size() ? words[i] : words.front();
    };
    for (std::size_t i = 0; i < texts.size(); ++i) {
      std::string text = texts[i];
      for (const auto& [element, words] : parts) {
        if (words.empty() || element.starts_with("label") || element == "value" || element == "valueXMLList")
          continue;
        const std::string word = at(words, i);
        text += element.starts_with("unit") ? " " + word : fmt::format("; {} = {}", symbol_of(element), word);
      }
      const std::string label = i < labels.size() ? labels[i] : texts.size() > 1 ? std::to_string(i + 1) : "";
      add(fmt::format("{}/{}", key, label.empty() ? "value" : label), names, label, text);
    }
  }

  /// The leaves of a number or a list of numbers. A covariance matrix is one statement.
  void gather(xmlNode* node, const std::string& key, const Names& names,
              std::vector<std::pair<std::string, std::vector<std::string>>>& parts) {
    for (xmlNode* child : children_of(node)) {
      const std::string name(local_name(child));
      if (name.starts_with("measurementUncertaintyMultivariate")) {
        std::string numbers;
        for (const std::string& word : xml_words(xml_content(child)))
          numbers += (numbers.empty() ? "" : " ") + word;
        add(key + "/" + name, names, "covariance", numbers);
      } else if (children_of(child).empty()) {
        parts.emplace_back(name, xml_words(xml_content(child)));
      } else {
        gather(child, key, names, parts);
      }
    }
  }

  std::vector<CertificateStatement> statements_;
};

std::string language_of(const std::vector<CertificateStatement>& statements) {
  for (const CertificateStatement& one : statements)
    if (one.key == std::string(kCore) + "usedLangCodeISO639_1") return one.text;
  return {};
}

std::string cut(const std::string& text) {
  constexpr std::size_t kLongest = 120;
  if (text.empty()) return "not stated";
  if (text.size() <= kLongest) return text;
  std::size_t end = kLongest;
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0U) == 0x80U)
    --end;  // Not within a character.
  return text.substr(0, end) + "...";
}

}  // namespace

AmendmentKind amendment_kind_from(const std::string& word) {
  if (const auto kind = kKinds.value(word)) return *kind;
  throw std::invalid_argument(fmt::format(
      "amendment \"{}\"; required: {} (no result and nothing of the item changes) or {} (every change "
      "is listed on the certificate)",
      word, kKinds.of(AmendmentKind::kAdministrative), kKinds.of(AmendmentKind::kTechnical)));
}

std::vector<CertificateStatement> statements_in(const std::string& xml, const std::string& source) {
  const XmlDocument document = parse_xml(xml, source);
  xmlNode* root = xmlDocGetRootElement(document.get());
  if (root == nullptr || local_name(root) != "digitalCalibrationCertificate")
    throw std::runtime_error(source + ": XML, but no digital calibration certificate");
  return Reader().read(root);
}

std::string ChangedStatement::words() const {
  return fmt::format("{}: {} → {}", name, cut(before), cut(after));
}

std::vector<ChangedStatement> changed_statements(const std::string& replaced_xml, const std::string& xml) {
  const std::vector<CertificateStatement> before = statements_in(replaced_xml, "the replaced certificate"),
                                          after = statements_in(xml, "the certificate");
  const bool same_language = language_of(before) == language_of(after);
  const auto counts = [&](const CertificateStatement& one) {
    return same_language || !one.in_language || one.administrative;
  };
  std::map<std::string, const CertificateStatement*> earlier;
  for (const CertificateStatement& one : before)
    if (counts(one)) earlier[one.key] = &one;
  std::vector<ChangedStatement> changed;
  std::set<std::string> said;
  const auto add = [&](const CertificateStatement& one, const std::string& text_before,
                       const std::string& text_after) {
    if (one.quantity.empty() || said.insert(one.quantity).second)
      changed.push_back({one.name, text_before, text_after, one.administrative});
  };
  for (const CertificateStatement& one : after) {
    if (!counts(one)) continue;
    const auto found = earlier.find(one.key);
    if (found == earlier.end()) {
      add(one, {}, one.text);
      continue;
    }
    if (found->second->text != one.text) add(one, found->second->text, one.text);
    earlier.erase(found);
  }
  for (const CertificateStatement& one : before)
    if (earlier.contains(one.key)) add(one, one.text, {});
  return changed;
}

}  // namespace abcal
