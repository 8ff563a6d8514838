#pragma once

#include <map>
#include <string>
#include <vector>

#include "app/document/document.h"
#include "app/document/number_text.h"
#include "app/formats/xml_query.h"
#include "app/laboratory/certificate/words.h"

namespace abcal {

/// Source of the pages of a certificate: its XML, and the words of its language.
struct PageSource {
  const XmlQuery& xml;
  Words words;

  std::string text(const std::string& path, xmlNode* from = nullptr) const { return xml.text(path, from); }
  /// The words below a name, a description, a declaration.
  std::string content(const std::string& path, xmlNode* from = nullptr) const {
    return xml.text(path + "/dcc:content", from);
  }
  /// The same where they are sentences, with their numbers typeset.
  std::string sentences(const std::string& path, xmlNode* from = nullptr) const {
    return typeset_numbers(content(path, from));
  }
  /// "2026-03-01 12:00:00", both if they differ.
  std::string say(Term sentence) const { return words(sentence).text; }
};

/// One value of a list or alone, as the XML has it or typeset.
struct PageValue {
  std::string label, value, expanded, factor, unit;
  std::string xml_label;  ///< The label as the XML has it, without a unit.
};

/// The values below a dcc:quantity in the digits and units of the XML. Every reader of a certificate, page or
/// JSON, takes them from here. @param own  those of a hybrid in the non-SI unit; else in SI units
std::vector<PageValue> printed_values(const XmlQuery& xml, xmlNode* quantity, bool own = false);

/// Whether a quantity, or one label of a list, has a mark (kOutsideScopeMark, kRaisedToScopeMark).
bool is_marked(const XmlQuery& xml, xmlNode* quantity, const std::string& mark,
               const std::string& label = "");

/// A value of the XML as the page shows it, in its language.
PageValue typeset(PageValue value, const Words& words);

/// printed_values(), typeset.
std::vector<PageValue> values_of(const PageSource& from, xmlNode* quantity, bool own = false);

/// Whether a quantity is given in a unit outside the SI as well.
bool is_hybrid(const PageSource& from, xmlNode* quantity);

/// "s_ux" of "s_ux[|g]".
std::string without_unit(const std::string& label);

/// "transverse_sensitivity_u", as limits name it, in words.
std::string quantity_words(const PageSource& from, std::string name);

/// The symbol that the first page has for a quantity, "s_u" for "intrinsic_sensitivity_u"; of others its
/// words.
std::string symbol_or_words(const PageSource& from, const std::string& name);

/// Quantities of a result, wherever its lists have them.
std::vector<xmlNode*> quantities_of(const XmlQuery& xml, xmlNode* result);
inline std::vector<xmlNode*> quantities_of(const PageSource& from, xmlNode* result) {
  return quantities_of(from.xml, result);
}

/// A table of quantities with U and k; every result is a group of rows.
DocumentTable value_table(const PageSource& from);
/// The rows of one quantity, which may be a list.
void add_value_rows(DocumentTable& table, const PageSource& from, xmlNode* quantity, bool own, bool in_words);
void add_rows(DocumentTable& table, const PageSource& from, xmlNode* result, bool own, bool in_words);

/// " *" for a quantity, or one label of a list, that is outside the laboratory's scope; else nothing.
std::string scope_star(const PageSource& from, xmlNode* quantity, const std::string& label = "");

/// "nu(s_u)" and its degrees of freedom, of those that are few.
std::map<std::string, std::string> degrees_of_freedom_of(const PageSource& from, xmlNode* quantity);

/// Coefficients, differences and curves of a series over temperature; and for the annex, its polynomials and
/// runs. @param series  its dcc:measurementResult
std::vector<Section> temperature_sections(const PageSource& from, xmlNode* series);
std::vector<Section> temperature_annex(const PageSource& from, xmlNode* series);

/// The sections of the annex.
/// @param shown  refTypes of the results that are on the customer's pages already
std::vector<Section> annex_sections(const PageSource& from, xmlNode* measurement,
                                    const std::vector<std::string>& shown);

}  // namespace abcal
