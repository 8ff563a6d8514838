#include "app/certificate/statements.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <set>

#include "app/units/dsi_unit.h"
#include "app/xml/xml_tree.h"

namespace abcal {
namespace {

Statement plain(std::string ref_type, std::string title, std::string text) {
  Statement statement;
  statement.ref_type = std::move(ref_type);
  statement.title = std::move(title);
  statement.text = std::move(text);
  return statement;
}

Statement traceability(const Certificate& certificate) {
  if (!certificate.not_traceable.empty()) {
    std::string reasons = "Metrological traceability is not claimed:";
    for (const std::string& reason : certificate.not_traceable) reasons += " " + reason + ".";
    return plain("abc_traceability", "Metrological traceability", reasons);
  }
  std::string text = "The results are traceable to the International System of Units (SI):";
  for (const Equipment& one : certificate.laboratory.equipment) {
    if (one.quantity == "other") continue;
    text += fmt::format(" {} by {} {}, certificate {} of {};", one.quantity, one.name, one.serial_number,
                        one.certificate, one.certificate_issuer);
  }
  const std::string& source = certificate.run.data.result().g_loc_source;
  text += fmt::format(" local gravity by {}{}.", source.empty() ? "a source that is not stated" : source,
                      certificate.laboratory.laboratory.gravity_site.empty()
                          ? ""
                          : ", at " + certificate.laboratory.laboratory.gravity_site);
  Statement statement = plain("abc_traceability", "Metrological traceability", text);
  statement.traceable = true;
  return statement;
}

/// Effects that the stated uncertainties do not cover, by the budget: sources without a line in it.
std::optional<Statement> not_covered(const Certificate& certificate) {
  const ReportData& data = certificate.run.data;
  if (!data.budget || !certificate.run.has_numbers()) return std::nullopt;
  std::string text =
      fmt::format("Not part of the stated uncertainties: {}.", fmt::join(data.budget->not_covered, "; "));
  return plain("abc_notCovered", "What the uncertainties leave out", text);
}

/// Every unit of the certificate that is not of the SI, and every output that is a count.
void add_units(std::vector<Statement>& statements, const Certificate& certificate) {
  std::set<std::string> units{certificate.run.data.record.response_unit};
  for (const CertifiedRun* run :
       {certificate.as_found ? &*certificate.as_found : nullptr, &certificate.run}) {
    if (run == nullptr) continue;
    for (const DerivedGroup& group : run->derived)
      for (const DerivedQuantity& quantity : group.quantities) units.insert(quantity.value.unit);
    for (const Decision& decision : run->decisions) units.insert(decision.limit.unit);
  }
  std::set<std::string> said;
  for (const std::string& unit : units) {
    const UnitInDsi in = unit_in_dsi(unit);
    if (in.own && said.insert(in.own->text()).second && !in.definition.empty()) {
      Statement statement = plain("abc_unit", "Unit " + unit, in.definition);
      statement.non_si_definition = in.definition;
      statement.non_si_unit = in.own->text();
      statements.push_back(statement);
    }
    if (!in.note.empty() && said.insert(in.note).second)
      statements.push_back(plain("abc_outputUnit", "Unit of the output", in.note));
  }
}

void add_optional(std::vector<Statement>& statements, const Certificate& certificate) {
  const Job& job = certificate.laboratory.job;
  const auto add = [&](const char* ref_type, const char* title, const std::string& text) {
    if (!one_line(text).empty()) statements.push_back(plain(ref_type, title, text));
  };
  add("abc_sampling", "Sampling", job.sampling);
  add("abc_deviations", "Additions to, deviations and exclusions from the method", job.deviations);
  add("abc_externalResults", "Results from external providers", job.external_results);
  add("abc_opinions", "Opinions and interpretations", job.opinions);
  if (certificate.as_found) add("basic_adjustment", "Adjustment", job.adjustment);
  if (!job.customer_supplied.empty()) {
    statements.push_back(plain(
        "abc_customerSupplied", "Data supplied by the customer",
        fmt::format("Supplied by the customer and not checked by the laboratory, which is not responsible "
                    "for what follows from them: {}.",
                    fmt::join(job.customer_supplied, ", "))));
  }
  if (job.recalibration) {
    Statement statement = plain("basic_recalibration", "Recalibration",
                                "Date of the next calibration, stated at the request of the customer.");
    statement.date = job.recalibration;
    statement.of_customer = true;
    statements.push_back(statement);
  }
}

void add_decision_rule(std::vector<Statement>& statements, const Certificate& certificate) {
  const auto& rule = certificate.laboratory.decision;
  if (!rule || certificate.laboratory.limits.empty()) return;
  Statement statement = plain("abc_decisionRule", "Decision rule", describe(*rule));
  statement.norms = {"JCGM 106:2012"};
  statement.references = {"Agreed in " + rule->agreement};
  std::set<std::string> specifications;
  for (const SpecificationLimit& limit : certificate.laboratory.limits)
    if (specifications.insert(limit.source).second)
      statement.references.push_back("Specification " + limit.source);
  statements.push_back(statement);
}

}  // namespace

std::vector<Statement> statements_of(const Certificate& certificate) {
  std::vector<Statement> statements;
  const ReportData& data = certificate.run.data;
  if (certificate.draft()) {
    std::string text = "DRAFT: this certificate is not issued and may not be used as one.";
    for (const std::string& reservation : certificate.reservations) text += " " + reservation + ".";
    statements.push_back(plain("abc_draft", "DRAFT", text));
  }
  if (certificate.training())
    statements.push_back(
        plain("abc_training", "TRAINING",
              "TRAINING: this certificate is of a training register. It certifies nothing and may not be "
              "used as a certificate."));
  if (!data.simulated.empty()) {
    statements.push_back(plain(
        "abc_simulated", "SIMULATED",
        fmt::format("SIMULATED: the {} {} not real; nothing was calibrated.",
                    fmt::join(data.simulated, " and the "), data.simulated.size() == 1 ? "was" : "were")));
  }
  if (const std::string of = data.label("replay.of"); !of.empty())
    statements.push_back(plain("abc_replayed", "REPLAYED",
                               "REPLAYED: repeated from the recording in " + of + ", not measured again."));
  statements.push_back(
      plain("abc_scope", "Scope",
            "The results relate only to the item calibrated, in the state in which it was and "
            "under the conditions that are stated."));
  statements.push_back(plain("abc_reproduction", "Reproduction",
                             "This certificate may not be reproduced except in full, unless the laboratory "
                             "agrees in writing."));
  statements.push_back(traceability(certificate));
  Statement uncertainty = plain("abc_uncertainty", "Uncertainty of measurement",
                                "Expanded uncertainties are the standard uncertainty multiplied by the "
                                "coverage factor k = 2, which for a "
                                "normal distribution corresponds to a coverage probability of approximately "
                                "95 %. Beside lists of results "
                                "stands their covariance with the factor of an ellipsoid of 95 %.");
  uncertainty.norms = {"JCGM 100:2008", "JCGM 102:2011"};
  statements.push_back(uncertainty);
  if (const auto left_out = not_covered(certificate)) statements.push_back(*left_out);
  add_decision_rule(statements, certificate);
  add_optional(statements, certificate);
  if (certificate.issue && certificate.issue->replaces) {
    const Replacement& replaced = *certificate.issue->replaces;
    statements.push_back(
        plain("abc_amendment", "Amendment",
              fmt::format("Replaces certificate {}. Reason: {}", replaced.number, replaced.reason)));
  }
  add_units(statements, certificate);
  return statements;
}

}  // namespace abcal
