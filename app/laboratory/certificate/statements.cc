#include "app/laboratory/certificate/statements.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <set>

#include "app/formats/dsi_unit.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certified_record.h"
#include "app/laboratory/certificate/measurand.h"
#include "app/laboratory/certificate/traceability.h"
#include "app/laboratory/register/records.h"
#include "protocol/record/run_operator.h"

namespace abcal {
namespace {

Statement plain(std::string ref_type, Wording title, Wording text) {
  Statement statement;
  statement.ref_type = std::move(ref_type);
  statement.title = std::move(title);
  statement.text = std::move(text);
  return statement;
}

/// Sentences behind a first one, in its language.
Wording with_reasons(const Words& words, Wording head, const std::vector<Message>& reasons) {
  for (const Message& reason : reasons) head.text += " " + words(reason).text + ".";
  return head;
}

Statement traceability(const Certificate& certificate) {
  const Words& words = certificate.words;
  const Wording title = words("Metrological traceability");
  if (!certificate.not_traceable.empty())
    return plain(
        "abc_traceability", title,
        with_reasons(words, words("Metrological traceability is not claimed:"), certificate.not_traceable));
  Wording text = words("The results are traceable to the International System of Units (SI):");
  for (const Equipment& one : certificate.laboratory.equipment) {
    // On what a record of the stage rests is a statement of its own.
    if (one.quantity == "other" || one.quantity == lab::kStageRecordQuantity) continue;
    text.text += " " + words("{quantity} by {name} {serial_number}, certificate {certificate} of {issuer};",
                             word_of(kQuantities, one.quantity), one.name, one.serial_number, one.certificate,
                             one.certificate_issuer)
                           .text;
  }
  const std::string& stated = certificate.run.data.result().g_loc_source;
  const std::string source = stated.empty() ? words("a source that is not stated").text : stated;
  const std::string& site = certificate.laboratory.laboratory.gravity_site;
  text.text += " " + (site.empty() ? words("local gravity by {source}.", source)
                                   : words("local gravity by {source}, at {place}.", source, site))
                         .text;
  if (is_serial_number_stated(certificate.run.data, "stage"))
    text.text +=
        " " +
        words("The serial number of the stage is stated by the bench file: the stage reports none.").text;
  if (is_serial_number_stated(certificate.run.data, "accelerometer"))
    text.text +=
        " " + words("The serial number of the voltmeter is stated by the bench file: it reports none.").text;
  text.text +=
      " " +
      words("That this thermometer measured the room is stated by the laboratory, not by the run.").text;
  Statement statement = plain("abc_traceability", title, text);
  statement.traceable = true;
  return statement;
}

/// Says whether the U of a result or that of its Monte Carlo is stated.
void add_monte_carlo(std::vector<Statement>& statements, const Words& words, const CertifiedRun& run,
                     const Wording& title) {
  if (!run.monte_carlo) return;
  const CertifiedUncertainty& made = *run.monte_carlo;
  Statement statement =
      plain("abc_monteCarlo", title,
            made.any_larger() ? words("{trials} trials of the whole evaluation (seed {seed}) gave an "
                                      "expanded uncertainty of {quantities} that is larger than the "
                                      "evaluated one; that of the trials and its covariance are stated.",
                                      made.trials, made.seed, made.larger())
                              : words("{trials} trials of the whole evaluation (seed {seed}) gave no larger "
                                      "expanded uncertainty; the evaluated one is stated.",
                                      made.trials, made.seed));
  statement.norms = {"JCGM 101:2008"};
  statements.push_back(statement);
}

/// Meaning of the stated uncertainties, with the coverage factor, and the sources that they exclude.
void add_uncertainty(std::vector<Statement>& statements, const Certificate& certificate) {
  const Words& words = certificate.words;
  Statement uncertainty =
      plain("abc_uncertainty", words("Uncertainty of measurement"),
            words("The expanded uncertainty U is the standard uncertainty of measurement multiplied by the "
                  "coverage factor k. It was evaluated following JCGM 100 and EA-4/02 M: 2022. The value of "
                  "the measurand lies within the stated interval with a probability of 95.45 %."));
  if (certificate.run.data.result().stage_record)
    uncertainty.text.text +=
        " " + words(
                  "U is that of the fit, in which the record of the stage has all its covariances; trials of "
                  "the whole evaluation (JCGM 101) were not made.")
                  .text;
  uncertainty.norms = {"JCGM 100:2008", "JCGM 102:2011", "EA-4/02 M: 2022"};
  statements.push_back(uncertainty);
  add_monte_carlo(statements, words, certificate.run, words("Monte Carlo of the result"));
  if (certificate.as_found)
    add_monte_carlo(statements, words, *certificate.as_found, words("Monte Carlo of the result as found"));
  const ReportData& data = certificate.run.data;
  if (!data.budget || !certificate.run.has_numbers()) return;
  std::string left_out;
  for (const Message& source : data.budget->not_covered)
    left_out += (left_out.empty() ? "" : "; ") + words(source).text;
  statements.push_back(plain("abc_notCovered", words("What the uncertainties leave out"),
                             words("Not part of the stated uncertainties: {effects}.", left_out)));
}

/// Every unit of the certificate that is not of the SI, and every output that is a count.
void add_units(std::vector<Statement>& statements, const Certificate& certificate) {
  const Words& words = certificate.words;
  std::set<std::string> units{certificate.run.data.record.response_unit};
  for (const CertifiedRun* run :
       {certificate.as_found ? &*certificate.as_found : nullptr, &certificate.run}) {
    if (run == nullptr) continue;
    for (const DerivedGroup& group : run->stated.derived)
      for (const DerivedQuantity& quantity : group.quantities) units.insert(quantity.value.unit);
    if (run->has_numbers()) units.insert(correction_unit(run->data.record.response_unit));
    for (const Decision& decision : run->decisions) units.insert(decision.stated.unit);
  }
  if (certificate.series && certificate.series->result)
    for (const TemperatureCoefficient& one : certificate.series->result->coefficients) units.insert(one.unit);
  std::set<std::string> said;
  for (const std::string& unit : units) {
    const UnitInDsi in = unit_in_dsi(unit, certificate.run.data.result().g_loc.value);
    if (in.own && said.insert(in.own->text()).second && !in.definition.empty()) {
      Statement statement =
          plain("abc_unit", words("Unit {unit}", unit), words("Definition: {definition}", in.definition));
      statement.non_si_definition = words(in.definition).text;
      statement.non_si_unit = in.own->text();
      statements.push_back(statement);
    }
    if (!in.note.empty() && said.insert(in.note).second)
      statements.push_back(plain("abc_outputUnit", words("Unit of the output"),
                                 words("1 stands for one digit of the output ({unit}).", unit)));
  }
}

void add_optional(std::vector<Statement>& statements, const Certificate& certificate) {
  const Words& words = certificate.words;
  const Job& job = certificate.laboratory.job;
  const auto add = [&](const char* ref_type, const Wording& title, const std::string& text) {
    if (!one_line(text).empty()) statements.push_back(plain(ref_type, title, words.as_given(text)));
  };
  add("abc_sampling", words("Sampling"), job.sampling);
  statements.push_back(
      plain("abc_deviations", words("Additions to, deviations and exclusions from the method"),
            one_line(job.deviations).empty() ? words("None.") : words.as_given(job.deviations)));
  add("abc_externalResults", words("Results from external providers"), job.external_results);
  add("abc_opinions", words("Opinions and interpretations"), job.opinions);
  if (certificate.as_found) add("basic_adjustment", words("Adjustment"), job.adjustment);
  if (!job.customer_supplied.empty()) {
    statements.push_back(plain("abc_customerSupplied", words("Data supplied by the customer"),
                               words("Supplied by the customer and not checked by the laboratory, which is "
                                     "not responsible for what follows from them: {data}.",
                                     fmt::format("{}", fmt::join(job.customer_supplied, ", ")))));
  }
  if (job.recalibration) {
    Statement statement =
        plain("basic_recalibration", words("Recalibration"),
              words("Date of the next calibration, stated at the request of the customer."));
    statement.date = job.recalibration;
    statement.of_customer = true;
    statements.push_back(statement);
  }
}

void add_decision_rule(std::vector<Statement>& statements, const Certificate& certificate) {
  const Words& words = certificate.words;
  const auto& rule = certificate.laboratory.decision;
  if (!rule || certificate.laboratory.limits.empty()) return;
  Statement statement = plain("abc_decisionRule", words("Decision rule"), describe(*rule, words));
  statement.norms = {"JCGM 106:2012"};
  statement.references = {words("Agreed in {agreement}", rule->agreement).text};
  std::set<std::string> specifications;
  for (const SpecificationLimit& limit : certificate.laboratory.limits)
    if (specifications.insert(limit.source).second)
      statement.references.push_back(words("Specification {source}", limit.source).text);
  statements.push_back(statement);
}

/// For several items of one run: the effect of the others on the results of this one.
void add_items_together(std::vector<Statement>& statements, const Certificate& certificate) {
  const ReportData& data = certificate.run.data;
  if (!data.is_one_of_several()) return;
  const Words& words = certificate.words;
  const std::vector<TrayItemResult>& items = data.all->joint.items;
  const bool together = data.result().estimator == "joint" && data.all->joint.stage &&
                        items.at(static_cast<std::size_t>(data.item) - 1).in_common_fit;
  statements.push_back(
      plain("abc_itemsTogether", words("Items measured together"),
            together ? words("Item {item} of {items} that were measured together on one stage. The errors of "
                             "the stage were estimated once, from the readings of {all} items; the "
                             "sensitivity matrix and the offsets are those of this item.",
                             data.item, items.size(), data.all->joint.stage->items)
                     : words("Item {item} of {items} that were measured together on one stage. Its results "
                             "are from its own readings alone.",
                             data.item, items.size())));
}

/// For a measurement of several runs: which they are, and how the item was mounted in each.
void add_runs(std::vector<Statement>& statements, const Words& words, const CertifiedRun& certified,
              const Wording& title) {
  const ReportData& data = certified.data;
  if (!data.is_of_several_runs()) return;
  Wording text = words(
      "The readings of {runs} runs were evaluated together. The sensitivity matrix is that of the item as it "
      "was mounted in the first of them, the offsets and the intrinsic properties are those of the item in "
      "the mean. By how much it changes from run to run is part of the uncertainty.",
      certified.together.size());
  for (std::size_t k = 0; k < certified.together.size(); ++k) {
    const ReportData& run = certified.together[k];
    text.text +=
        " " + words("{file}: begun {begun}, {mounting}, by {names}.", run.path.filename().string(),
                    run.started_utc(), data.result().series.at(k).mounting, describe(operators_of(*run.run)))
                  .text;
  }
  statements.push_back(plain("abc_runs", title, text));
}

/// For results that use a record of the stage: what it is, and on what it rests.
void add_stage_records(std::vector<Statement>& statements, const Certificate& certificate) {
  const auto add = [&](const ReportData& data, const Wording& title) {
    if (data.result().stage_record) statements.push_back(stage_record_statement(certificate, data, title));
  };
  add(certificate.run.data, certificate.words("Record of the stage"));
  if (certificate.as_found)
    add(certificate.as_found->data, certificate.words("Record of the stage, as found"));
}

/// Says which certificate an amendment replaces, why, and every statement that it changes.
Statement amendment(const Words& words, const Replacement& replaced) {
  Wording text = words("Replaces certificate {number}. Reason: {reason}.", replaced.number, replaced.reason);
  text.text += " " + (replaced.kind == AmendmentKind::kAdministrative
                          ? words("Administrative amendment: results and item are unchanged.")
                          : words("Technical amendment."))
                         .text;
  text.text +=
      " " + (replaced.changed.empty() ? words("No statement was changed.")
                                      : words("Changed statements: {changes}.", replaced.changed.size()))
                .text;
  Statement statement = plain("abc_amendment", words("Amendment"), text);
  for (const ChangedStatement& one : replaced.changed) statement.references.push_back(one.words());
  return statement;
}

/// Warnings that must be seen first: draft, training, simulation, recording.
void add_warnings(std::vector<Statement>& statements, const Certificate& certificate) {
  const Words& words = certificate.words;
  const ReportData& data = certificate.run.data;
  if (certificate.draft())
    statements.push_back(
        plain("abc_draft", words("DRAFT"),
              with_reasons(words, words("DRAFT: this certificate is not issued and may not be used as one."),
                           certificate.reservations)));
  if (certificate.training())
    statements.push_back(plain("abc_training", words("TRAINING"),
                               words("TRAINING: this certificate certifies nothing. It is of a training "
                                     "register and may not be used as a certificate.")));
  if (!data.simulated.empty()) {
    std::string of;
    for (const std::string& instrument : data.simulated)
      of += (of.empty() ? "" : ", ") + words(word_of(kRoles, instrument)).text;
    statements.push_back(plain(
        "abc_simulated", words("SIMULATED"),
        words("SIMULATED: these instruments were not real: {instruments}. Nothing was calibrated.", of)));
  }
  if (const std::string of = data.label("replay.of"); !of.empty())
    statements.push_back(
        plain("abc_replayed", words("REPLAYED"),
              words("REPLAYED: repeated from the recording in {source}, not measured again.", of)));
}

}  // namespace

std::vector<Statement> statements_of(const Certificate& certificate) {
  const Words& words = certificate.words;
  std::vector<Statement> statements;
  add_warnings(statements, certificate);
  statements.push_back(plain("abc_scope", words("Scope"),
                             words("The results relate only to the item calibrated, in the state in which it "
                                   "was and under the conditions that are stated.")));
  statements.push_back(plain("abc_reproduction", words("Reproduction"),
                             words("This certificate may not be reproduced except in full, unless the "
                                   "laboratory agrees in writing.")));
  statements.push_back(identity_statement(words, certificate.run.data));
  if (certificate.run.has_numbers()) statements.push_back(measurand_statement(words));
  statements.push_back(traceability(certificate));
  add_items_together(statements, certificate);
  add_runs(statements, words, certificate.run, words("Runs evaluated together"));
  if (certificate.as_found)
    add_runs(statements, words, *certificate.as_found, words("Runs evaluated together, as found"));
  add_stage_records(statements, certificate);
  add_uncertainty(statements, certificate);
  add_decision_rule(statements, certificate);
  add_optional(statements, certificate);
  if (certificate.issue && certificate.issue->replaces) {
    const Replacement& replaced = *certificate.issue->replaces;
    statements.push_back(amendment(words, replaced));
  }
  if (certificate.issue && !certificate.issue->witnessing.by.empty()) {
    const RunWitnessing& witnessing = certificate.issue->witnessing;
    statements.push_back(plain("abc_witness", words("Witness"),
                               words("Each of the {angles} angles of the run was signed by the witness with "
                                     "the key of {key} when it was measured.",
                                     witnessing.angles, witnessing.by)));
  } else if (certificate.issue && !certificate.issue->witnessing.statement.empty()) {
    statements.push_back(
        plain("abc_witness", words("Witness"),
              words("The run was not witnessed. Statement of the person who approved: {statement}",
                    certificate.issue->witnessing.statement)));
  }
  if (certificate.issue && certificate.issue->entry) {
    Statement entry =
        plain("abc_register", words("Register"),
              words("An entry of the laboratory's register gave this certificate its number. The hash is "
                    "that of this entry and of all before it. With this certificate the laboratory or an "
                    "assessor finds out whether the register was copied back or rewritten since."));
    entry.references = {reference_of(*certificate.issue->entry)};
    statements.push_back(entry);
  }
  add_units(statements, certificate);
  return statements;
}

}  // namespace abcal
