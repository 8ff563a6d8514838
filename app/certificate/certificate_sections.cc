#include "app/certificate/certificate_sections.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <utility>

#include "app/certificate/statements.h"
#include "app/results/result_text.h"

namespace abcal {
namespace {

std::string joined_lines(const std::vector<std::string>& parts) {
  std::string text;
  for (const std::string& part : parts)
    if (!part.empty()) text += (text.empty() ? "" : ", ") + part;
  return text;
}

std::string address(const Contact& contact) {
  return joined_lines({contact.name, contact.street,
                       contact.post_code.empty() ? contact.city : contact.post_code + " " + contact.city,
                       contact.state, contact.country_code, contact.email, contact.phone});
}

std::string role_of(const LaboratoryFile& laboratory, const std::string& name) {
  for (const Person& person : laboratory.persons)
    if (person.name == name) return joined_lines({name, person.role});
  return name.empty() ? "not stated" : name;
}

Section certificate_section(const Certificate& certificate) {
  const LaboratoryFile& from = certificate.laboratory;
  FactList list;
  const auto add = [&](const std::string& name, const std::string& text) {
    if (!text.empty()) list.facts.emplace_back(name, text);
  };
  add("Certificate", certificate.number);
  if (certificate.issue && certificate.issue->replaces)
    add("Replaces", certificate.issue->replaces->number + ": " + certificate.issue->replaces->reason);
  add("Laboratory", address(from.laboratory.contact));
  add("Accreditation", from.laboratory.accreditation);
  add("Place of calibration", from.laboratory.performance_location);
  add("Customer", address(from.customer));
  add("Order", from.job.order);
  add("Item", joined_lines({from.job.item_name, from.job.owner_id}));
  add("Condition on receipt", from.job.condition);
  if (from.job.received) add("Received", format_date(*from.job.received));
  add("Procedure", from.job.procedure);
  for (const RunOperator& who : certificate.operators)
    add("Measured by", role_of(from, who.name) + (who.verified() ? "" : fmt::format(" ({})", kNotVerified)));
  add("Approved by",
      certificate.issue ? role_of(from, certificate.issue->approved_by) : "not approved: DRAFT");
  add("Date of issue", certificate.issue ? format_date(certificate.issue->date) : "not issued: DRAFT");
  return {"Certificate", {list}};
}

Section equipment_section(const Certificate& certificate) {
  DocumentTable table;
  table.columns = {{"Equipment", CellKind::kText},
                   {"Serial number", CellKind::kText},
                   {"For", CellKind::kText},
                   {"Certificate", CellKind::kText},
                   {"Valid until", CellKind::kNumber}};
  for (const Equipment& one : certificate.laboratory.equipment) {
    table.rows.push_back({joined_lines({one.name, one.maker, one.model}), one.serial_number, one.quantity,
                          joined_lines({one.certificate, one.certificate_issuer}),
                          one.due ? format_date(*one.due) : "not stated"});
  }
  return {"Equipment and its calibration", {table}};
}

std::string rounded(double value, double u) {
  // Two digits of the uncertainty; the value to the same place.
  if (!std::isfinite(value)) return "-";
  if (!(u > 0.0) || !std::isfinite(u)) return fmt::format("{:.6g}", value);
  const int decimals = decimals_for(u);
  if (decimals > 15) return fmt::format("{:.6g}", value);
  const std::string text = with_decimals(value, decimals);
  return text.find_first_of("123456789") == std::string::npos && text.front() == '-' ? text.substr(1) : text;
}

/// "transverse_sensitivity_u", as limits name it, in words.
std::string words_of(std::string name) {
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

/// "0.98 to 1.02", "at most 2".
std::string interval(const std::optional<double>& low, const std::optional<double>& high,
                     const std::function<std::string(double)>& shown) {
  if (low && high) return shown(*low) + " to " + shown(*high);
  return high ? "at most " + shown(*high) : "at least " + shown(*low);
}

Section derived_section(const CertifiedRun& run) {
  Section section{"Further quantities", {}};
  DocumentTable table;
  table.may_break = true;
  table.columns = {{"Quantity", CellKind::kText},
                   {"Value", CellKind::kNumber},
                   {"U (k = 2)", CellKind::kNumber},
                   {"Unit", CellKind::kUnit}};
  for (const DerivedGroup& group : run.derived) {
    table.rows.push_back({group.words});
    for (const DerivedQuantity& quantity : group.quantities) {
      const double expanded = kCoverageFactor * quantity.value.standard_uncertainty;
      table.rows.push_back({words_of(quantity.name), rounded(quantity.value.value, expanded),
                            rounded(expanded, expanded), quantity.value.unit});
    }
  }
  section.blocks.push_back(table);
  return section;
}

Section decision_section(const std::string& title, const Certificate& certificate, const CertifiedRun& run) {
  DocumentTable table;
  table.columns = {{"Quantity", CellKind::kText},
                   {"Value", CellKind::kNumber},
                   {"U (k = 2)", CellKind::kNumber},
                   {"Limits", CellKind::kText},
                   {"Acceptance", CellKind::kText},
                   {"Unit", CellKind::kUnit},
                   {"Within the limits", CellKind::kNumber},
                   {"Decision", CellKind::kText}};
  for (const Decision& decision : run.decisions) {
    const double expanded = decision.expanded_uncertainty;
    const auto as_given = [](double limit) { return fmt::format("{:.6g}", limit); };
    const auto as_measured = [expanded](double limit) { return rounded(limit, expanded); };
    table.rows.push_back(
        {words_of(decision.limit.quantity), rounded(decision.value, expanded), rounded(expanded, expanded),
         interval(decision.limit.lower, decision.limit.upper, as_given),
         interval(decision.lower_acceptance, decision.upper_acceptance, as_measured), decision.limit.unit,
         fmt::format("{:.4g} %", 100.0 * decision.conformance_probability),
         std::string(to_string(decision.conformity))});
  }
  return {title, {Paragraph{describe(*certificate.laboratory.decision)}, table}};
}

Section shift_section(const Certificate& certificate) {
  DocumentTable table;
  table.caption = "As left minus as found; uncertainties take both calibrations as independent.";
  table.columns = {{"Quantity", CellKind::kText},
                   {"Difference", CellKind::kNumber},
                   {"U (k = 2)", CellKind::kNumber},
                   {"Unit", CellKind::kUnit},
                   {"E_n", CellKind::kNumber}};
  for (const Shift& shift : certificate.shifts) {
    const double expanded = kCoverageFactor * shift.difference.standard_uncertainty;
    table.rows.push_back({words_of(shift.name), rounded(shift.difference.value, expanded),
                          rounded(expanded, expanded), shift.difference.unit,
                          fmt::format("{:.2f}", shift.normalised_error)});
  }
  Section section{"As found and as left", {}};
  section.blocks.emplace_back(std::move(table));
  section.blocks.push_back(Paragraph{"Adjustment: " + certificate.laboratory.job.adjustment});
  return section;
}

Section statement_section(const Certificate& certificate) {
  FactList list;
  for (const Statement& statement : statements_of(certificate)) {
    std::string text = statement.text;
    if (statement.date) text += " " + format_date(*statement.date);
    for (const std::string& reference : statement.references) text += " " + reference + ".";
    list.facts.emplace_back(statement.title, text);
  }
  return {"Statements", {list}};
}

}  // namespace

void add_certificate_sections(Document& document, const Certificate& certificate) {
  document.title = "Calibration certificate";
  document.subtitle = certificate.number;
  document.identification = certificate.number + "; " + document.identification;
  if (certificate.draft()) {
    document.page_mark = "DRAFT";
    document.cautions.insert(document.cautions.begin(), "DRAFT: this certificate is not issued");
  }
  if (certificate.training()) {
    document.page_mark = "TRAINING";
    document.cautions.insert(document.cautions.begin(), "TRAINING: this certificate certifies nothing");
  }
  for (const std::string& reservation : certificate.reservations) document.cautions.push_back(reservation);
  document.sections.insert(document.sections.begin(),
                           {certificate_section(certificate), equipment_section(certificate)});
  // Derived quantities follow the results; the statements are at the end.
  std::vector<Section> results;
  if (!certificate.run.decisions.empty())
    results.push_back(decision_section(certificate.as_found ? "Conformity as left" : "Conformity",
                                       certificate, certificate.run));
  if (certificate.as_found && !certificate.as_found->decisions.empty())
    results.push_back(decision_section("Conformity as found", certificate, *certificate.as_found));
  if (!certificate.shifts.empty()) results.push_back(shift_section(certificate));
  if (!certificate.run.derived.empty()) results.push_back(derived_section(certificate.run));
  auto& sections = document.sections;
  auto behind = std::find_if(sections.begin(), sections.end(),
                             [](const Section& section) { return section.title == "Result"; });
  if (behind != sections.end()) ++behind;
  sections.insert(behind, results.begin(), results.end());
  document.sections.push_back(statement_section(certificate));
}

}  // namespace abcal
