#include "app/laboratory/certificate/dcc_administrative.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "app/laboratory/certificate/country_name.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/measurand.h"
#include "app/laboratory/certificate/statements.h"

namespace abcal {
namespace {

void add_coordinates(XmlElement& location, const Laboratory& laboratory) {
  if (!laboratory.latitude_deg || !laboratory.longitude_deg) return;
  XmlElement position = location.add("dcc:positionCoordinates");
  position.add("dcc:positionCoordinateSystem", "WGS 84");
  const auto coordinate = [&](std::string_view element, double value, std::string_view unit) {
    XmlElement child = position.add(element);
    child.add("si:value", dsi_number(value, element));
    child.add("si:unit", unit);
  };
  coordinate("dcc:positionCoordinate1", *laboratory.latitude_deg, "\\degree");
  coordinate("dcc:positionCoordinate2", *laboratory.longitude_deg, "\\degree");
  if (laboratory.height_m) coordinate("dcc:positionCoordinate3", *laboratory.height_m, "\\metre");
}

XmlElement add_contact_lines(XmlElement& contact, const Words& words, const Contact& from) {
  add_name(contact, "dcc:name", from.name);
  add_line(contact, "dcc:eMail", from.email);
  add_line(contact, "dcc:phone", from.phone);
  XmlElement location = contact.add("dcc:location");
  add_line(location, "dcc:street", from.street);
  add_line(location, "dcc:postCode", from.post_code);
  add_line(location, "dcc:city", from.city);
  add_line(location, "dcc:state", from.state);
  add_line(location, "dcc:countryCode", from.country_code);
  if (const std::string name = country_name(from.country_code, words.language()); !name.empty())
    add_words(location, "dcc:further", words.as_given(name));
  return location;
}

/// The dates of one certificate: of the first run's start and of the last one's end.
std::pair<Date, Date> performed(const Certificate& certificate) {
  const auto [begin_utc, end_utc] = period_of(runs_of(certificate));
  const auto begin = parse_date(begin_utc), end = parse_date(end_utc);
  if (!begin || !end)
    throw std::runtime_error(certificate.run.data.path.string() + ": the run does not say when it was made");
  return {*begin, *end};
}

void add_core_data(XmlElement& administrative, const Certificate& certificate) {
  const LaboratoryFile& laboratory = certificate.laboratory;
  XmlElement core = administrative.add("dcc:coreData");
  core.add("dcc:countryCodeISO3166_1", laboratory.laboratory.contact.country_code);
  core.add("dcc:usedLangCodeISO639_1", certificate.words.language());
  core.add("dcc:mandatoryLangCodeISO639_1", certificate.words.language());
  add_line(core, "dcc:uniqueIdentifier", certificate.number);
  if (const std::string order = one_line(laboratory.job.order); !order.empty()) {
    XmlElement identifications = core.add("dcc:identifications");
    add_identification(identifications, "customer", order, certificate.words("Order"));
  }
  if (laboratory.job.received) core.add("dcc:receiptDate", format_date(*laboratory.job.received));
  const auto [begin, end] = performed(certificate);
  core.add("dcc:beginPerformanceDate", format_date(begin));
  core.add("dcc:endPerformanceDate", format_date(end));
  core.add("dcc:performanceLocation", laboratory.laboratory.performance_location);
  if (!certificate.issue) return;
  core.add("dcc:issueDate", format_date(certificate.issue->date));
  if (const auto& replaced = certificate.issue->replaces) {
    XmlElement change = core.add("dcc:reportAmendedSubstituted");
    change.add("dcc:typeOfChange", "amended");
    add_line(change, "dcc:replacedUniqueIdentifier", replaced->number);
    if (!replaced->sha256.empty())
      add_hash(core, "dcc:previousReport", certificate.words("The certificate that this one replaces"),
               replaced->number, replaced->sha256);
  }
}

void add_items(XmlElement& administrative, const Certificate& certificate) {
  const ReportData& data = certificate.run.data;
  const Job& job = certificate.laboratory.job;
  const Words& words = certificate.words;
  XmlElement item = administrative.add("dcc:items").add("dcc:item");
  add_name(item, "dcc:name", job.item_name);
  add_words(item, "dcc:description", words("Condition on receipt: {condition}", one_line(job.condition)));
  if (const std::string maker = one_line(data.label("item.maker")); !maker.empty()) {
    XmlElement manufacturer = item.add("dcc:manufacturer");
    add_name(manufacturer, "dcc:name", maker);
  }
  add_line(item, "dcc:model", data.label("item.model"));
  XmlElement identifications = item.add("dcc:identifications");
  add_identification(identifications, "manufacturer", data.label("item.serial_number"),
                     words("Serial number"));
  // The number entered for this run takes precedence, since the laboratory file may serve several items.
  const std::string entered = data.label("item.customer_number");
  const std::string owner_id = entered.empty() ? job.owner_id : entered;
  if (!one_line(owner_id).empty())
    add_identification(identifications, "customer", owner_id, words("Number of the owner"));
  if (identifications.node()->children == nullptr)  // The schema asks for one, in a draft too.
    add_identification(identifications, "other", words("not stated").text, words("Identity"));

  add_item_quantities(item, words, data);
}

void add_persons(XmlElement& administrative, const Certificate& certificate) {
  const Words& words = certificate.words;
  XmlElement persons = administrative.add("dcc:respPersons");
  for (const RunOperator& who : certificate.operators)
    add_person(persons, certificate.laboratory, who.name,
               (who.verified() ? words("measured by") : words("measured by (stated, not verified)")).text,
               false);
  if (certificate.issue)
    add_person(persons, certificate.laboratory, certificate.issue->approved_by, words("approved by").text,
               true);
}

void add_statement(XmlElement& statements, const Words& words, const Statement& from,
                   const Contact& customer) {
  XmlElement statement = statements.add("dcc:statement");
  statement.attribute("refType", from.ref_type);
  add_words(statement, "dcc:name", from.title);
  if (from.traceable) statement.add("dcc:traceable", "true");
  for (const std::string& norm : from.norms) add_line(statement, "dcc:norm", norm);
  for (const std::string& reference : from.references) add_line(statement, "dcc:reference", reference);
  add_words(statement, "dcc:declaration", from.text);
  if (from.date) statement.add("dcc:date", format_date(*from.date));
  if (from.of_customer) {
    XmlElement authority = statement.add("dcc:respAuthority");
    add_contact_lines(authority, words, customer);
  }
  add_line(statement, "dcc:nonSIDefinition", from.non_si_definition);
  add_line(statement, "dcc:nonSIUnit", from.non_si_unit);
}

}  // namespace

void add_person(XmlElement& persons, const LaboratoryFile& laboratory, const std::string& name,
                const std::string& part, bool main_signer) {
  const auto found = std::find_if(laboratory.persons.begin(), laboratory.persons.end(),
                                  [&](const Person& person) { return person.name == name; });
  XmlElement responsible = persons.add("dcc:respPerson");
  XmlElement person = responsible.add("dcc:person");
  add_name(person, "dcc:name", name);
  if (found != laboratory.persons.end()) add_line(person, "dcc:eMail", found->email);
  std::string role = part;
  if (found != laboratory.persons.end()) role += ", " + found->role;
  add_line(responsible, "dcc:role", role);
  responsible.add("dcc:mainSigner", main_signer ? "true" : "false");
}

void add_software_and_definitions(XmlElement& administrative, const Words& words,
                                  const std::string& program_version) {
  XmlElement software = administrative.add("dcc:dccSoftware");
  add_software(software, words, "abcal", program_version);
  XmlElement definition = administrative.add("dcc:refTypeDefinitions").add("dcc:refTypeDefinition");
  add_words(definition, "dcc:name",
            words("Triaxial accelerometers calibrated by rotations in gravity (ABC protocol)"));
  definition.add("dcc:namespace", "abc");
  definition.add("dcc:link", "https://doi.org/10.6028/jres.126.038");
}

void add_laboratory(XmlElement& administrative, const Words& words, const Laboratory& laboratory) {
  XmlElement element = administrative.add("dcc:calibrationLaboratory");
  add_line(element, "dcc:calibrationLaboratoryCode", laboratory.accreditation);
  XmlElement contact = element.add("dcc:contact");
  XmlElement location = add_contact_lines(contact, words, laboratory.contact);
  add_coordinates(location, laboratory);
}

void add_customer(XmlElement& administrative, const Words& words, const Contact& customer) {
  XmlElement element = administrative.add("dcc:customer");
  add_contact_lines(element, words, customer);
}

void add_administrative_data(XmlElement& root, const Certificate& certificate) {
  XmlElement administrative = root.add("dcc:administrativeData");
  add_software_and_definitions(administrative, certificate.words, certificate.program_version);
  add_core_data(administrative, certificate);
  add_items(administrative, certificate);

  add_laboratory(administrative, certificate.words, certificate.laboratory.laboratory);
  add_persons(administrative, certificate);
  add_customer(administrative, certificate.words, certificate.laboratory.customer);
  XmlElement statements = administrative.add("dcc:statements");
  for (const Statement& statement : statements_of(certificate))
    add_statement(statements, certificate.words, statement, certificate.laboratory.customer);
}

}  // namespace abcal
