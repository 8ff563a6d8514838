#include "app/laboratory/certificate/certificate_page.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <stdexcept>

#include "app/laboratory/certificate/measurand.h"
#include "app/laboratory/certificate/page_numbers.h"
#include "app/laboratory/certificate/page_parts.h"
#include "app/laboratory/certificate/registered_entry.h"
#include "app/laboratory/certificate/scope.h"

namespace abcal {
namespace {

/// Rows of quantities and decisions for which the second page has room, and the number of rows that the
/// heading and the words of such a table take.
constexpr std::size_t kRoomOnSecondPage = 9, kRowsOfDecisionWords = 7, kRowsOfHeading = 4;

void add_fact(FactList& list, const std::string& name, const std::string& text) {
  if (!text.empty()) list.facts.emplace_back(name, text);
}

std::string joined(const std::vector<std::string>& parts, std::string_view between = ", ") {
  std::string text;
  for (const std::string& part : parts)
    if (!part.empty()) text += (text.empty() ? std::string() : std::string(between)) + part;
  return text;
}

std::string address(const PageSource& from, const std::string& contact) {
  const std::string at = contact + "/dcc:location/";
  return joined({from.content(contact + "/dcc:name"), from.text(at + "dcc:street"),
                 joined({from.text(at + "dcc:postCode"), from.text(at + "dcc:city")}, " "),
                 from.text(at + "dcc:state"), from.content(at + "dcc:further"),
                 from.text(contact + "/dcc:eMail"), from.text(contact + "/dcc:phone")});
}

std::string identification(const PageSource& from, const std::string& of, Term name) {
  return from.text(
      fmt::format("{}/dcc:identifications/dcc:identification[dcc:name/dcc:content=\"{}\"]/dcc:value", of,
                  from.say(name)));
}

/// Where the calibration was made: whose place, and its city where that is one of the two addresses.
std::string place_of(const PageSource& from) {
  const std::string administrative = "dcc:administrativeData/",
                    of = from.text(administrative + "dcc:coreData/dcc:performanceLocation");
  const std::string contact = of == "laboratory" ? administrative + "dcc:calibrationLaboratory/dcc:contact"
                              : of == "customer" ? administrative + "dcc:customer"
                                                 : "";
  return joined({from.words(word_of(kPlaces, of)).text,
                 contact.empty() ? "" : from.text(contact + "/dcc:location/dcc:city")});
}

/// Parties, item and dates: the head of the first page.
Section head_section(const PageSource& from) {
  const std::string administrative = "dcc:administrativeData/", core = administrative + "dcc:coreData/",
                    item = administrative + "dcc:items/dcc:item";
  SideBySide parties;
  add_fact(parties.left, from.say("Laboratory"),
           address(from, administrative + "dcc:calibrationLaboratory/dcc:contact"));
  add_fact(parties.left, from.say("Accreditation"),
           from.text(administrative + "dcc:calibrationLaboratory/dcc:calibrationLaboratoryCode"));
  add_fact(parties.right, from.say("Customer"), address(from, administrative + "dcc:customer"));
  add_fact(parties.right, from.say("Order"),
           from.text(core + "dcc:identifications/dcc:identification/dcc:value"));
  SideBySide facts;
  add_fact(facts.left, from.say("Object"), from.content(item + "/dcc:name"));
  add_fact(facts.left, from.say("Manufacturer"),
           identity_value(from, "Manufacturer", from.content(item + "/dcc:manufacturer/dcc:name")));
  add_fact(facts.left, from.say("Type"), identity_value(from, "Type", from.text(item + "/dcc:model")));
  add_fact(facts.left, from.say("Serial number"),
           identity_value(from, "Serial number", identification(from, item, "Serial number")));
  add_fact(facts.left, from.say("Number of the owner"), identification(from, item, "Number of the owner"));
  const std::string begin = from.text(core + "dcc:beginPerformanceDate"),
                    end = from.text(core + "dcc:endPerformanceDate");
  add_fact(facts.right, from.say("Date of calibration"), begin == end ? end : begin + " – " + end);
  const std::string issued = from.text(core + "dcc:issueDate");
  add_fact(facts.right, from.say("Date of issue"), issued.empty() ? from.say("not issued: DRAFT") : issued);
  add_fact(facts.right, from.say("Received"), from.text(core + "dcc:receiptDate"));
  add_fact(facts.right, from.say("Place of calibration"), place_of(from));
  add_fact(facts.right, from.say("Replaces"),
           from.text(core + "dcc:reportAmendedSubstituted/dcc:replacedUniqueIdentifier"));
  FactList condition;
  add_fact(condition, from.say("Identity"),
           from.content(administrative + "dcc:statements/dcc:statement[@refType='abc_itemIdentity']/"
                                         "dcc:declaration"));
  add_fact(condition, from.say("Condition"), from.content(item + "/dcc:description"));
  return {"", {parties, facts, condition}};
}

xmlNode* result_of(const PageSource& from, xmlNode* measurement, const std::string& ref_type) {
  const auto found = from.xml.nodes("dcc:results/dcc:result[@refType='" + ref_type + "']", measurement);
  return found.empty() ? nullptr : found.front();
}

/// "pass", "none possible"
std::string verdict_words(const PageSource& from, xmlNode* facts) {
  const std::string verdict = from.text("dcc:conformity", facts);
  return verdict.empty() ? from.say("none possible") : from.words(word_of(kConformityWords, verdict)).text;
}

/// The decisions in one sentence; empty: there are none.
std::string conformity_words(const PageSource& from, xmlNode* measurement) {
  xmlNode* result = result_of(from, measurement, "abc_conformity");
  if (result == nullptr) return "";
  std::map<std::string, int> verdicts;
  for (xmlNode* quantity : quantities_of(from, result))
    ++verdicts[verdict_words(
        from, from.xml.nodes("dcc:measurementMetaData/dcc:metaData[@refType='basic_conformity']", quantity)
                  .front())];
  std::string counts;
  for (const auto& [verdict, count] : verdicts)
    counts += fmt::format("{}{}: {}", counts.empty() ? "" : ", ", verdict, count);
  return from.words("Conformity with specification, number of decisions: {counts}.", counts).text;
}

/// The main results: matrix, intrinsic properties, offsets.
Section result_section(const PageSource& from, xmlNode* measurement, const std::string& title) {
  Section section{title, {}};
  if (xmlNode* none = result_of(from, measurement, "abc_noResult")) {
    section.blocks.push_back(Paragraph{from.content("dcc:data/dcc:text", none)});
    return section;
  }
  if (const std::string words = conformity_words(from, measurement); !words.empty())
    section.blocks.push_back(Paragraph{words});
  DocumentTable table = value_table(from);
  for (const char* ref_type :
       {"abc_sensitivityMatrix", "abc_intrinsicSensitivities", "abc_intrinsicAngles", "abc_offsets"}) {
    xmlNode* result = result_of(from, measurement, ref_type);
    if (result == nullptr) throw std::runtime_error(std::string("the certificate has no result ") + ref_type);
    add_rows(table, from, result, false, false);
    const auto quantities = quantities_of(from, result);
    if (ref_type != std::string_view("abc_offsets") || !is_hybrid(from, quantities.front())) continue;
    const std::size_t heading = table.rows.size();
    add_rows(table, from, result, true, false);
    table.rows[heading].front() += " (" + table.rows.back().back() + ")";
  }
  section.blocks.emplace_back(std::move(table));
  if (xmlNode* matrix = result_of(from, measurement, "abc_sensitivityMatrix"))
    section.blocks.push_back(Paragraph{
        from.content("dcc:description", matrix) + " " +
        from.say("k is that of the effective degrees of freedom ν; ∞: so many that they do not change k.") +
        (from.xml.any(fmt::format(".//dcc:metaData[@refType='{}']", kOutsideScopeMark), measurement)
             ? " " + from.say("*: outside the scope that the laboratory states.")
             : "")});
  return section;
}

/// The response at each rate.
Section rate_section(const PageSource& from, xmlNode* result, const std::string& title) {
  DocumentTable table = value_table(from);
  for (xmlNode* rate : from.xml.nodes("dcc:data/dcc:list", result)) {
    const auto number = [&](const char* ref_type) {
      const auto found = from.xml.nodes(fmt::format("dcc:quantity[@refType='{}']", ref_type), rate);
      if (found.empty()) throw std::runtime_error(std::string("a response has no ") + ref_type);
      return values_of(from, found.front()).front();
    };
    const PageValue turn = number("abc_rate"), frequency = number("abc_frequency");
    table.rows.push_back(
        {fmt::format("{} {}, {} {}", frequency.value, frequency.unit, turn.value, turn.unit)});
    for (xmlNode* quantity : from.xml.nodes("dcc:quantity[@refType='basic_measuredValue']", rate))
      add_value_rows(table, from, quantity, false, false);
  }
  return {
      title,
      {std::move(table), Paragraph{from.content("dcc:description", result) + " " +
                                   from.say("A: amplitude of each output; theta: phase of all of them.")}}};
}

/// @param as_stated  in the unit in which the limit is stated, with this unit; else in the SI unit of the
/// decision
std::string limit_of(const PageSource& from, xmlNode* facts, const std::string& kind, bool as_stated) {
  const std::string lower = "dcc:data/dcc:quantity[@refType='basic_" + kind + "Lower']",
                    upper = "dcc:data/dcc:quantity[@refType='basic_" + kind + "Upper']";
  std::string unit;
  const auto shown = [&](const std::string& path) -> std::string {
    const auto found = from.xml.nodes(path, facts);
    if (found.empty()) return "";
    const PageValue value =
        values_of(from, found.front(), as_stated && is_hybrid(from, found.front())).front();
    if (as_stated && value.unit != "1") unit = " " + value.unit;
    return value.value;
  };
  const std::string low = shown(lower), high = shown(upper);
  if (!low.empty() && !high.empty()) return from.words("{from} to {to}", low, high).text + unit;
  if (low.empty() && high.empty()) return "";
  return (low.empty() ? "≤ " + high : "≥ " + low) + unit;
}

Section decision_section(const PageSource& from, xmlNode* result, const std::string& title) {
  DocumentTable table;
  table.dense = true;
  table.columns = {{from.say("Quantity"), CellKind::kSymbol},
                   {from.say("Value"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {from.say("Unit"), CellKind::kUnit},
                   {from.say("Tolerance"), CellKind::kLimits},
                   {from.say("Acceptance"), CellKind::kLimits},
                   {"P", CellKind::kNumber},
                   {from.say("Risk"), CellKind::kNumber},
                   {from.say("Decision"), CellKind::kUnit}};
  for (xmlNode* quantity : quantities_of(from, result)) {
    const PageValue value = values_of(from, quantity).front();  // In SI units, as on the first page.
    const auto metadata =
        from.xml.nodes("dcc:measurementMetaData/dcc:metaData[@refType='basic_conformity']", quantity);
    xmlNode* facts = metadata.front();
    const auto probability = [&](const char* ref_type) {
      return typeset_number(
          from.text(fmt::format("dcc:data/dcc:quantity[@refType='{}']/si:real/si:value", ref_type), facts),
          from.words);
    };
    table.rows.push_back(
        {symbol_or_words(from, from.content("dcc:name", quantity)) + scope_star(from, quantity), value.value,
         value.expanded, value.unit, limit_of(from, facts, "toleranceLimit", true),
         limit_of(from, facts, "acceptanceLimit", false), probability("abc_conformanceProbability"),
         probability("abc_risk"), verdict_words(from, facts)});
  }
  Section section{title, {}};
  section.blocks.emplace_back(std::move(table));
  const auto undecided = from.xml.nodes(
      "dcc:data/dcc:quantity//dcc:metaData[@refType='basic_conformity'][not(dcc:conformity)]", result);
  section.blocks.push_back(Paragraph{
      from.content("dcc:description", result) + " " +
      (undecided.empty() ? "" : from.content("dcc:description", undecided.front()) + " ") +
      from.content("dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_decisionRule']/"
                   "dcc:declaration") +
      " " +
      joined(from.xml.texts("dcc:administrativeData/dcc:statements/"
                            "dcc:statement[@refType='abc_decisionRule']/dcc:reference"),
             "; ") +
      "."});
  return section;
}

Section shift_section(const PageSource& from, xmlNode* result) {
  DocumentTable table;
  table.caption = from.content("dcc:description", result);
  table.columns = {{from.say("Quantity"), CellKind::kSymbol},
                   {from.say("Difference"), CellKind::kNumber},
                   {"U", CellKind::kNumber},
                   {from.say("Unit"), CellKind::kUnit},
                   {"E_n", CellKind::kNumber}};
  for (xmlNode* quantity : quantities_of(from, result)) {
    const PageValue value = values_of(from, quantity).front();
    table.rows.push_back(
        {symbol_or_words(from, from.content("dcc:name", quantity)) + scope_star(from, quantity), value.value,
         value.expanded, value.unit,
         typeset_number(from.text("dcc:measurementMetaData/dcc:metaData[@refType='abc_normalisedError']/"
                                  "dcc:data/dcc:quantity/si:real/si:value",
                                  quantity),
                        from.words)});
  }
  return {from.content("dcc:name", result), {table}};
}

/// Room, item, local gravity.
Section condition_section(const PageSource& from, xmlNode* measurement) {
  FactList list;
  for (xmlNode* condition :
       from.xml.nodes("dcc:influenceConditions/dcc:influenceCondition[dcc:data/dcc:quantity]", measurement)) {
    std::vector<PageValue> values;
    for (xmlNode* quantity : from.xml.nodes("dcc:data/dcc:quantity", condition))
      values.push_back(values_of(from, quantity, is_hybrid(from, quantity)).front());
    std::string text = values.front().value;
    if (values.size() > 1 && values.back().value != text)
      text = from.words("{from} to {to}", text, values.back().value).text;
    text += " " + values.front().unit;
    if (!values.front().expanded.empty())
      text +=
          ", U = " + values.front().expanded + " " + values.front().unit + ", k = " + values.front().factor;
    const std::string source = from.content("dcc:description", condition);
    add_fact(list, from.content("dcc:name", condition), source.empty() ? text : text + "; " + source);
  }
  return {from.say("Conditions"), {list}};
}

Section equipment_section(const PageSource& from, xmlNode* measurement) {
  DocumentTable table;
  table.dense = true;
  table.columns = {{from.say("Traceable quantity")},
                   {from.say("Equipment")},
                   {from.say("Certificate")},
                   {from.say("Calibrated on"), CellKind::kUnit},
                   {from.say("Valid until"), CellKind::kUnit}};
  for (xmlNode* one : from.xml.nodes("dcc:measuringEquipments/dcc:measuringEquipment", measurement)) {
    const auto fact = [&](Term name) {
      return from.text(
          fmt::format("dcc:identifications/dcc:identification[dcc:name/dcc:content=\"{}\"]/dcc:value",
                      from.say(name)),
          one);
    };
    if (fact("Traceable quantity").empty()) continue;  // An instrument as it identified itself.
    table.rows.push_back(
        {fact("Traceable quantity"),
         joined({from.content("dcc:name", one), from.content("dcc:manufacturer/dcc:name", one),
                 from.text("dcc:model", one), fact("Serial number")}),
         joined({fact("Calibration certificate"), fact("Issuer of the certificate")}), fact("Calibrated on"),
         fact("Valid until")});
  }
  Section section{from.say("Metrological traceability"), {}};
  const std::string claim =
      "dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_traceability']";
  if (from.text(claim + "/dcc:traceable") == "true") {
    section.blocks.push_back(Paragraph{
        from.say("The results are traceable to the International System of Units (SI) by this equipment:")});
  } else {
    // "Metrological traceability is not claimed: ...", with every reason in the annex.
    const std::string reasons = from.content(claim + "/dcc:declaration");
    section.blocks.push_back(
        Paragraph{reasons.substr(0, reasons.find(':')) + ". " + from.say("The annex has the reasons.")});
  }
  if (!table.rows.empty()) section.blocks.emplace_back(std::move(table));
  return section;
}

/// The statements that every customer has to read.
Section statement_section(const PageSource& from) {
  FactList list;
  for (const char* ref_type :
       {"abc_measurand", "abc_uncertainty", "abc_monteCarlo", "abc_stageRecord", "abc_deviations",
        "abc_scope", "abc_reproduction", "abc_sampling", "abc_externalResults", "abc_opinions",
        "basic_adjustment", "abc_customerSupplied", "basic_recalibration", "abc_amendment", "abc_witness"}) {
    for (xmlNode* statement : from.xml.nodes(
             fmt::format("dcc:administrativeData/dcc:statements/dcc:statement[@refType='{}']", ref_type)))
      add_fact(list, from.content("dcc:name", statement),
               joined({from.sentences("dcc:declaration", statement), from.text("dcc:date", statement)}, " "));
  }
  return {from.say("Statements"), {list}};
}

/// Every statement that an amendment changed; nothing without an amendment that changed any.
Section amendment_section(const PageSource& from) {
  const std::vector<std::string> changed = from.xml.texts(
      "dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_amendment']/dcc:reference");
  Section section{from.say("Changed statements"), {}};
  if (!changed.empty()) section.blocks.emplace_back(BulletList{changed});
  return section;
}

Section person_section(const PageSource& from) {
  SideBySide persons;
  for (xmlNode* person : from.xml.nodes("dcc:administrativeData/dcc:respPersons/dcc:respPerson")) {
    const bool signer = from.text("dcc:mainSigner", person) == "true";
    FactList& list = signer ? persons.right : persons.left;
    add_fact(list, from.content("dcc:person/dcc:name", person), from.text("dcc:role", person));
  }
  add_fact(persons.left, from.say("Date of calibration"),
           from.text("dcc:administrativeData/dcc:coreData/dcc:endPerformanceDate"));
  const std::string issued = from.text("dcc:administrativeData/dcc:coreData/dcc:issueDate");
  if (issued.empty()) {
    add_fact(persons.right, from.say("approved by"), from.say("not approved: DRAFT"));
  } else {
    add_fact(persons.right, from.say("Date of issue"), issued);
  }
  const bool is_signed = from.xml.any("ds:Signature");
  Section section{
      from.say("Persons and signatures"),
      {persons,
       Paragraph{is_signed ? from.say("The XML of this certificate, which is attached to the PDF, is signed "
                                      "electronically; it is the certificate.")
                           : from.say("The XML of this certificate is attached to the PDF; it is the "
                                      "certificate.")}}};
  if (const auto entry = registered_entry_of(from.xml))
    section.blocks.push_back(
        Paragraph{from.words("Register {register}, entry {entry}, {digits}", entry->register_identity,
                             entry->entry, entry->digits_on_paper())
                      .text});
  return section;
}

/// Marks, and the sentence of each that must be seen first.
void add_marks(const PageSource& from, Document& document) {
  struct Mark {
    const char* ref_type;
    Term mark;
  };
  for (const auto& [ref_type, mark] : {Mark{"abc_draft", "DRAFT"},
                                       {"abc_training", "TRAINING"},
                                       {"abc_simulated", ""},
                                       {"abc_replayed", ""}}) {
    const std::string text = from.content(fmt::format(
        "dcc:administrativeData/dcc:statements/dcc:statement[@refType='{}']/dcc:declaration", ref_type));
    if (text.empty()) continue;
    if (document.page_mark.empty() && !mark.english().empty()) document.page_mark = from.say(mark);
    document.cautions.push_back(
        text.substr(0, text.find(". ") == std::string::npos ? text.size() : text.find(". ") + 1));
  }
}

/// Derived quantities for which the second page has room.
Section further_section(const PageSource& from, xmlNode* measurement, std::size_t room,
                        std::vector<std::string>& shown) {
  DocumentTable table = value_table(from);
  for (xmlNode* result : from.xml.nodes("dcc:results/dcc:result", measurement)) {
    const std::string ref_type = owned_text(xmlGetProp(result, as_xml("refType")));
    const bool offered = ref_type.starts_with("abc_sensitivityInUnit") ||
                         ref_type == "abc_transverseSensitivity" || ref_type == "abc_misalignment" ||
                         ref_type == "abc_nonOrthogonality" || ref_type == "abc_bias" ||
                         ref_type == "abc_transverseAzimuth";
    constexpr std::size_t kRowsOfGroup = 4;  // of three outputs
    if (!offered || kRowsOfHeading + table.rows.size() + kRowsOfGroup > room) continue;
    add_rows(table, from, result, true, true);
    shown.push_back(ref_type);
  }
  Section section{from.say("Further quantities"), {}};
  if (!table.rows.empty()) section.blocks.emplace_back(std::move(table));
  return section;
}

/// The annex of every calibration, and of a series over temperature.
/// @param shown  refTypes of the last calibration's results that are on the customer's pages already
void add_annex(const PageSource& from, const std::vector<xmlNode*>& measurements,
               const std::vector<xmlNode*>& series, const std::vector<std::string>& shown,
               Document& document) {
  const bool pair = measurements.size() > 1;
  for (xmlNode* measurement : measurements) {
    std::vector<Section> annex = annex_sections(
        from, measurement, measurement == measurements.back() ? shown : std::vector<std::string>{});
    if (annex.empty()) continue;
    // The annex goes on behind the signatures, so that no page is left half empty.
    const std::string name = pair ? ", " + from.content("dcc:name", measurement) : "";
    annex.front().title = from.say("Annex") + name + ": " + annex.front().title;
    std::move(annex.begin(), annex.end(), std::back_inserter(document.sections));
  }
  for (xmlNode* one : series) {
    std::vector<Section> annex = temperature_annex(from, one);
    annex.front().title =
        from.say("Annex") + ", " + from.content("dcc:name", one) + ": " + annex.front().title;
    std::move(annex.begin(), annex.end(), std::back_inserter(document.sections));
  }
}

}  // namespace

Document certificate_page(const std::string& xml) {
  const XmlDocument parsed = parse_xml(xml, "certificate");
  const XmlQuery query(parsed.get());
  const PageSource from{query,
                        Words(query.text("dcc:administrativeData/dcc:coreData/dcc:usedLangCodeISO639_1"))};
  Document document;
  document.language = from.words.language();
  document.page_words = from.words("page {page} of {pages}", Stated{"{}"}, Stated{"{}"}).text;
  document.figure_words = from.words("Figure {number}: {title}", Stated{"{}"}, Stated{"{}"}).text;
  document.title = from.say("Calibration certificate");
  document.subtitle = from.text("dcc:administrativeData/dcc:coreData/dcc:uniqueIdentifier");
  const std::string serial_number =
      identification(from, "dcc:administrativeData/dcc:items/dcc:item", "Serial number");
  document.identification =
      joined({document.subtitle,
              from.content("dcc:administrativeData/dcc:calibrationLaboratory/dcc:contact/dcc:name"),
              serial_number.empty()
                  ? ""
                  : from.say("Serial number") + " " + identity_value(from, "Serial number", serial_number)},
             " · ");
  document.origin =
      "abcal, " + from.content("dcc:administrativeData/dcc:dccSoftware/dcc:software/dcc:description");
  add_marks(from, document);
  document.sections.push_back(head_section(from));
  const auto measurements =
      query.nodes("dcc:measurementResults/dcc:measurementResult[not(@refType='abc_temperatureSeries')]");
  const auto series =
      query.nodes("dcc:measurementResults/dcc:measurementResult[@refType='abc_temperatureSeries']");
  if (measurements.empty()) throw std::runtime_error("the certificate has no results");
  const bool pair = measurements.size() > 1;
  for (xmlNode* measurement : measurements)
    document.sections.push_back(result_section(
        from, measurement, pair ? from.content("dcc:name", measurement) : from.say("Results")));

  // The second page: decisions first, then results as far as they fit.
  xmlNode* last = measurements.back();
  std::size_t used = 0;
  std::vector<Section> second;
  for (xmlNode* measurement : measurements) {
    xmlNode* decisions = result_of(from, measurement, "abc_conformity");
    if (decisions == nullptr) continue;
    used += quantities_of(from, decisions).size() + kRowsOfDecisionWords;
    second.push_back(
        decision_section(from, decisions,
                         pair ? from.say("Conformity") + ": " + from.content("dcc:name", measurement)
                              : from.say("Conformity")));
  }
  for (xmlNode* measurement : measurements) {
    xmlNode* rates = result_of(from, measurement, "abc_responseAtRates");
    if (rates == nullptr) continue;
    second.push_back(rate_section(
        from, rates,
        from.content("dcc:name", rates) + (pair ? ": " + from.content("dcc:name", measurement) : "")));
    used = kRoomOnSecondPage;
  }
  if (xmlNode* shift = result_of(from, last, "abc_shift")) {
    second.push_back(shift_section(from, shift));
    used += 12;
  }
  std::vector<std::string> shown;
  Section further = further_section(from, last, kRoomOnSecondPage - std::min(used, kRoomOnSecondPage), shown);
  if (!further.blocks.empty()) second.push_back(std::move(further));
  if (Section equation = equation_section(from, last); !equation.blocks.empty())
    second.push_back(std::move(equation));
  if (Section mounting = mounting_section(from); !mounting.blocks.empty())
    second.push_back(std::move(mounting));
  second.push_back(condition_section(from, last));
  second.push_back(equipment_section(from, last));
  second.push_back(statement_section(from));
  second.push_back(person_section(from));
  second.front().on_new_page = true;
  std::move(second.begin(), second.end(), std::back_inserter(document.sections));
  for (xmlNode* one : series) {
    std::vector<Section> over_temperature = temperature_sections(from, one);
    std::move(over_temperature.begin(), over_temperature.end(), std::back_inserter(document.sections));
  }
  add_annex(from, measurements, series, shown, document);
  if (Section changed = amendment_section(from); !changed.blocks.empty()) {
    changed.title = from.say("Annex") + ": " + changed.title;
    document.sections.push_back(std::move(changed));
  }
  return document;
}

}  // namespace abcal
