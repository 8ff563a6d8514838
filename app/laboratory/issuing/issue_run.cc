#include "app/laboratory/issuing/issue_run.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

#include "app/formats/xml_query.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/laboratory/certificate/traceability.h"
#include "app/laboratory/compare/check_chart.h"
#include "app/laboratory/issuing/evidence_files.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/issuing/run_evidence.h"
#include "app/laboratory/issuing/run_sources.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/system/interrupt.h"
#include "app/system/read_file.h"
#include "app/witness/time_stamp_authority.h"
#include "app/witness/witness_client.h"
#include "drivers/text/text.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

/// @throws std::invalid_argument  if the certificate that is to be replaced is of another item of the run
void require_replaced_of_this_item(const IssueAsked& asked) {
  const auto count = static_cast<int>(items_of_file(asked.run));
  const int certified = std::max(1, asked.item);
  for (int item = 1; item <= count; ++item) {
    if (item == certified) continue;
    for (const IssuedCertificate& issued : ResultsFile::certificates(asked.run, item))
      if (issued.number == asked.replaces)
        throw std::invalid_argument(
            fmt::format("--replaces {}: is of item {}, another item of {}; required: a certificate of item "
                        "{}, which is to be certified",
                        asked.replaces, item, asked.run, certified));
  }
}

IssueFacts facts_of(const IssueAsked& asked, const std::string& now_utc) {
  IssueFacts facts;
  facts.number = asked.number;
  facts.measured_by = asked.measured_by;
  facts.approved_by = asked.approved_by;
  facts.today = parse_date(now_utc);
  const auto date = parse_date(asked.date.empty() ? now_utc : asked.date);
  if (!date || (!asked.date.empty() && asked.date.size() != 10))
    throw std::invalid_argument("--date " + asked.date + ": required: a date, 2026-03-01");
  facts.date = *date;
  if (asked.replaces.empty() != asked.reason.empty() || asked.replaces.empty() != asked.amendment.empty())
    throw std::invalid_argument(
        "--replaces NUMBER, --reason TEXT and --amendment administrative or technical go together");
  if (asked.replaces.empty()) return facts;
  require_replaced_of_this_item(asked);
  facts.replaces = Replacement{asked.replaces, asked.reason, {}, amendment_kind_from(asked.amendment), {}};
  return facts;
}

/// @throws std::invalid_argument  if the certificate in `asked.replaced_xml` is of another item than the run
void require_replaced_xml_of_item(const IssueAsked& asked, const std::string& xml, const ReportData& data) {
  const XmlDocument document = parse_xml(xml, asked.replaced_xml);
  const XmlQuery query(document.get());
  const std::string item = "dcc:administrativeData/dcc:items/dcc:item/";
  const std::array<std::string, 3> found{
      query.text(item + "dcc:manufacturer/dcc:name/dcc:content"), query.text(item + "dcc:model"),
      query.text(item + "dcc:identifications/dcc:identification[dcc:issuer='manufacturer']/dcc:value")};
  const std::array<std::string, 3> certified{one_line(data.label("item.maker")),
                                             one_line(data.label("item.model")),
                                             one_line(data.label("item.serial_number"))};
  if (found == certified) return;
  throw std::invalid_argument(fmt::format(
      "--replaced {}: certificate {} is of {}, another item; required: one of {}, which is to be certified",
      asked.replaced_xml, asked.replaces, fmt::join(found, " "), fmt::join(certified, " ")));
}

/// The XML of the certificate that is replaced: kept with the run, or else given as a file.
std::string xml_of_replaced(const IssueAsked& asked, Registered* registered, const ReportData& data) {
  const std::vector<IssuedCertificate> kept = ResultsFile::certificates(asked.run, asked.item);
  for (const IssuedCertificate& issued : kept)
    if (issued.number == asked.replaces) return issued.xml;
  if (!kept.empty())
    throw std::runtime_error(
        fmt::format("certificate {}: is not of this run, whose last is {}; required: --replaces {}",
                    asked.replaces, kept.back().number, kept.back().number));
  if (asked.replaced_xml.empty())
    throw std::invalid_argument(
        fmt::format("certificate {}: is not kept with {}; required: --replaced FILE, its XML, so that what "
                    "the amendment changes can be listed",
                    asked.replaces, asked.run));
  std::string xml = read_file(asked.replaced_xml, kLargestXml);
  const lab::RegisterEvidence evidence = evidence_of_certificate(asked.replaced_xml, xml);
  if (evidence.certificate->number != asked.replaces)
    throw std::invalid_argument(fmt::format("--replaced {}: is certificate {}; required: {}",
                                            asked.replaced_xml, evidence.certificate->number,
                                            asked.replaces));
  require_replaced_xml_of_item(asked, xml, data);
  if (registered == nullptr) return xml;
  const auto status = registered->opened.status_of(asked.replaces);
  if (!status || status->record.xml_sha256 != evidence.certificate->xml_sha256)
    throw std::invalid_argument(fmt::format(
        "--replaced {}: is not the certificate {} that the register knows; required: the XML with SHA-256 {}",
        asked.replaced_xml, asked.replaces, status ? status->record.xml_sha256 : "of the register"));
  return xml;
}

/// Lists what an amendment changes. One that is administrative changes no result.
void compare_with_replaced(const IssueAsked& asked, Registered* registered, Certificate& certificate) {
  Replacement& replaced = *certificate.issue->replaces;
  const std::string earlier = xml_of_replaced(asked, registered, certificate.run.data);
  replaced.sha256 = sha256_of(earlier);
  replaced.changed = changed_statements(earlier, checked_xml(certificate, nullptr));
  if (asked.tell_changes) asked.tell_changes(replaced.changed);
  if (replaced.kind != AmendmentKind::kAdministrative) return;
  std::string technical;
  std::size_t count = 0;
  for (const ChangedStatement& one : replaced.changed) {
    if (one.administrative) continue;
    ++count;
    technical += "\n  " + one.words();
  }
  if (count > 0)
    throw std::runtime_error(fmt::format(
        "an administrative amendment of certificate {} for the reason \"{}\" would change {} statement{} on "
        "results or item; required: none, or --amendment technical, which lists them on the certificate:{}",
        asked.replaces, asked.reason, count, count == 1 ? "" : "s", technical));
}

/// The persons of the register, which replace those of the laboratory file.
std::vector<Person> persons_of(lab::Register& opened) {
  std::vector<Person> persons;
  for (const lab::Person& from : opened.persons()) {
    if (!from.valid_to.empty()) continue;
    Person person{from.name, from.role, from.email, {}};
    for (const lab::Right right : from.rights) person.may.emplace_back(to_string(right));
    persons.push_back(std::move(person));
  }
  return persons;
}

/// The scope of the register, which replaces that of the laboratory file.
std::vector<ScopeLimit> scope_of(lab::Register& opened) {
  std::vector<ScopeLimit> scope;
  for (const lab::ScopeEntry& entry : opened.scope())
    if (entry.retired.empty())
      scope.push_back({entry.quantity, entry.unit, entry.from, entry.to, entry.cmc, entry.relative, 0});
  return scope;
}

/// A laboratory file of another laboratory than the register's is a problem of the file.
void require_laboratory_of(const lab::RegisterFacts& facts, ReadLaboratoryFile& laboratory) {
  const std::string& name = laboratory.file.laboratory.contact.name;
  if (name.empty() || pieces::trimmed(name) == pieces::trimmed(facts.name)) return;
  laboratory.problems.push_back(
      {"[laboratory] name", fmt::format("\"{}\"", name),
       fmt::format("\"{}\", the laboratory of the register: use its laboratory file", facts.name)});
}

void use_register(Registered& registered, CertificateRequest& request) {
  IssueFacts& facts = *request.issue;
  facts.number = "as the register gives it";
  facts.approved_by = registered.approver.name();
  facts.register_identity = registered.opened.facts().identity;
  facts.training = registered.opened.facts().training;
  require_laboratory_of(registered.opened.facts(), request.laboratory);
  request.laboratory.file.persons = persons_of(registered.opened);
  request.laboratory.file.scope = scope_of(registered.opened);
}

void add(std::vector<std::string>& warnings, const std::vector<std::string>& more) {
  warnings.insert(warnings.end(), more.begin(), more.end());
}

void record_issued(Registered& registered, const IssuedCertificate& issued, const Clock& clock,
                   std::vector<std::string>& warnings) {
  add(warnings, registered.opened.record_issued(registered.approver, issued.number, sha256_of(issued.xml),
                                                issued.date, clock.utc_now()));
  const CertificateFacts facts = certificate_facts(issued.number, issued.xml);
  (void)registered.opened.tell_certificate(registered.approver, issued.number, facts.addressee,
                                           facts.run_sha256s, clock.utc_now());
}

/// Completes an issue whose program ended after the certificate was kept with the run and before it was
/// registered.
/// @return its number; absent: this was not the case
std::optional<std::string> record_kept_certificate(Registered& registered, const IssueAsked& asked,
                                                   const Clock& clock, std::vector<std::string>& warnings) {
  const auto kept = ResultsFile::certificates(asked.run, asked.item);
  for (const lab::CertificateRecord& one : registered.opened.certificates_of(sha256_of_file(asked.run))) {
    const auto found = std::find_if(kept.begin(), kept.end(), [&](const IssuedCertificate& issued) {
      return issued.number == one.number;
    });
    if (one.state != "reserved" || found == kept.end()) continue;
    record_issued(registered, *found, clock, warnings);
    return one.number;
  }
  return std::nullopt;
}

/// The name of an item in the register; no two items of a run have the same.
std::string item_name(const ReportData& data) {
  return fmt::format("{} {} {}", data.label("item.maker"), data.label("item.model"),
                     data.label("item.serial_number"));
}

void take_number(Registered& registered, Certificate& certificate, const Clock& clock,
                 std::vector<std::string>& warnings) {
  const ReportData& data = certificate.run.data;
  lab::NumberRequest request;
  request.run_sha256 = data.sha256.value();
  request.item = item_name(data);
  request.measured_by = certificate.measured_by();
  const BenchIdentity bench = subject_of(*data.run).bench;
  request.stage = bench.stage;
  request.bench = bench.name;
  for (const ReportData* run : runs_of(certificate)) {
    const std::vector<Equipment> kept = equipment_of_run(*run);
    request.runs.push_back(run_record_of(run->path, run->sha256.value(), *run->run,
                                         kept.empty() ? certificate.laboratory.equipment : kept));
  }
  if (const auto& replaced = certificate.issue->replaces) {
    request.replaces = replaced->number;
    request.reason = replaced->reason;
  }
  const lab::ReservedNumber reserved =
      registered.opened.reserve_number(registered.approver, request, clock.utc_now());
  certificate.number = certificate.issue->number = reserved.number;
  certificate.issue->entry =
      RegisteredEntry{registered.opened.facts().identity, reserved.head.entries, reserved.head.sha256};
  add(warnings, reserved.warnings);
}

/// With a register, an approver signs with a key of their own that the register knows.
/// @param from  source of the certificate of the key, for messages
void require_own_key(Registered& registered, const std::string& certificate_pem, const Message& from,
                     Clock::UtcTime now) {
  const CertificateSubject subject = subject_of(certificate_pem);
  const std::string fingerprint = fingerprint_of(subject.public_pem), today = format_utc(now);
  const std::string& approver = registered.approver.name();
  for (const lab::SigningKey& key : registered.opened.keys()) {
    if (key.fingerprint != fingerprint || key.kind != "person" || key.owner != approver) continue;
    if (!key.valid_to.empty())
      throw Telling<std::invalid_argument>(
          Message("{from}: the key of \"{name}\" was retired on {date}; required: a key that is valid", from,
                  subject.name, key.valid_to));
    if (today < subject.valid_from_utc || today > subject.valid_to_utc)
      throw Telling<std::invalid_argument>(
          Message("{from}: the certificate of \"{name}\" is valid from {begin} to {end}; required: one that "
                  "is valid today",
                  from, subject.name, subject.valid_from_utc, subject.valid_to_utc));
    return;
  }
  throw Telling<std::invalid_argument>(
      Message("{from}: the key of \"{name}\", which is none of {approver}'s in the register; required: a key "
              "of the approver's own (abcal lab key \"{owner}\" --kind person --certificate FILE)",
              from, subject.name, approver, approver));
}

/// The register cannot forget what a witness signed of it: whoever issues does not choose to do without one.
/// @throws std::invalid_argument  if ABCAL_WITNESS=none declines the witness of a register that has one
void use_witness(Registered& registered) {
  if (!registered.witness) registered.witness = head_witness(registered.opened.facts().identity);
  const std::optional<std::int64_t> newest = registered.opened.newest_witnessed_head();
  if (!registered.witness && newest) {
    if (WitnessClient::is_declined())
      throw std::invalid_argument(
          fmt::format("ABCAL_WITNESS=none: found a register whose state a witness has signed, last at entry "
                      "{}; required: "
                      "that witness. Unset ABCAL_WITNESS",
                      *newest));
    registered.witness = [](std::int64_t, const std::string&) { return std::nullopt; };  // A warning says so.
  }
  registered.opened.set_witness(registered.witness);
}

/// Evidence of the runs of a certificate, as `abcal verify` judges them.
struct EvidenceOfRuns {
  RunWitnessing witnessing;  ///< That of the calibration itself.
  std::string problems;      ///< Why it is not issued; empty: nothing is against it.
};

EvidenceOfRuns judge_runs(const IssueAsked& asked, Registered* registered) {
  const std::vector<std::string> calibration = runs_of_file(asked.run);
  std::vector<std::string> runs = calibration;
  if (!asked.certificate.as_found.empty())
    for (std::string& run : runs_of_file(asked.certificate.as_found)) runs.push_back(std::move(run));
  for (const std::string& point : asked.certificate.temperature)
    if (std::ranges::find(runs, point) == runs.end()) runs.push_back(point);
  lab::Register* opened = registered == nullptr ? nullptr : &registered->opened;
  Trust trust;
  if (opened != nullptr) trust.keys = bench_keys(*opened);
  EvidenceOfRuns of_all;
  std::size_t witnessed = 0;
  for (const std::string& run : runs) {
    if (!RunFile::looks_like_run_file(run) || !RunFile::is_closed(run))
      continue;  // make_certificate() reports it.
    const RunEvidence evidence = judge_run(run, trust, opened);
    const std::string missing = opened == nullptr ? "" : missing_witness(evidence, *opened);
    for (const IntegrityCheck& check : evidence.checks)
      if (!check.good && check.what != kWitnessRequired)
        of_all.problems += fmt::format("\n  {}, {}: {}", run, check.what, check.found);
    if (missing.empty()) {
      if (evidence.is_witnessed && std::ranges::find(calibration, run) != calibration.end()) {
        ++witnessed;
        of_all.witnessing.by = evidence.witness;
        of_all.witnessing.angles += evidence.angles;
      }
    } else if (asked.not_witnessed.empty()) {
      of_all.problems += fmt::format(
          "\n  {}: {}; to certify it all the same, the approver states why: --not-witnessed TEXT, which is "
          "printed on the certificate",
          run, missing);
    } else {
      of_all.witnessing.statement = asked.not_witnessed;
    }
  }
  // A witness of some runs of a measurement is none of the measurement.
  if (witnessed < calibration.size() || !of_all.witnessing.statement.empty())
    of_all.witnessing = {{}, 0, of_all.witnessing.statement};
  return of_all;
}

/// The certificate of a complete run, with its number.
Certificate numbered_certificate(const IssueAsked& asked, Registered* registered, const Clock& clock,
                                 std::vector<std::string>& warnings) {
  const Clock::UtcTime now = clock.utc_now();
  const EvidenceOfRuns evidence = judge_runs(asked, registered);
  CertificateRequest request;
  request.laboratory = read_laboratory_file(asked.certificate.laboratory);
  if (!asked.certificate.language.empty()) request.laboratory.file.language = asked.certificate.language;
  request.run = gather_report(asked.run, now, asked.item);
  if (!asked.certificate.as_found.empty())
    request.as_found = gather_same_item("--as-found", asked.certificate.as_found, request.run, now);
  add_monte_carlo(request);
  gather_runs(request, now);
  request.series = gather_series(asked.certificate.temperature, request.run, now);
  request.issue = facts_of(asked, format_utc(now));
  request.issue->witnessing = evidence.witnessing;
  if (registered != nullptr) use_register(*registered, request);
  Certificate certificate = make_certificate(std::move(request));
  if (!evidence.problems.empty())
    throw std::runtime_error("`abcal verify` does not accept what is to be certified:" + evidence.problems);
  if (certificate.issue->replaces) compare_with_replaced(asked, registered, certificate);
  end_orderly_at_signals();  // A certificate that has its number must be kept, registered and written.
  if (registered != nullptr) take_number(*registered, certificate, clock, warnings);
  return certificate;
}

}  // namespace

IssueOutcome issue_run(const IssueAsked& asked, Registered* registered, const Clock& clock) {
  (void)chosen_item(asked.run, asked.item);
  IssueOutcome outcome;
  if (asked.key.empty() != asked.key_certificate.empty())
    throw std::invalid_argument("--sign KEY.pem and --certificate CERT.pem go together");
  if (registered != nullptr) {
    use_witness(*registered);
    if (auto known = record_kept_certificate(*registered, asked, clock, outcome.warnings)) {
      outcome.known_now = *std::move(known);
      return outcome;
    }
    if (!asked.key.empty())
      require_own_key(*registered, read_file(asked.key_certificate),
                      Message("--certificate {file}", asked.key_certificate), clock.utc_now());
  }
  for (const std::string& run : runs_of_file(asked.run))
    if (RunFile::is_closed(run))
      if (const auto why = stamp_if_configured(run)) outcome.warnings.push_back(*why);
  const DccSchema schema = schema_of(asked.certificate);
  const Certificate certificate = numbered_certificate(asked, registered, clock, outcome.warnings);
  std::optional<SigningKey> key;
  if (!asked.key.empty()) key = SigningKey{asked.key, asked.key_certificate};
  outcome.issued = issue_certificate(certificate, &schema, key, format_utc(clock.utc_now()));
  if (registered != nullptr) record_issued(*registered, outcome.issued, clock, outcome.warnings);
  outcome.training = certificate.training();
  outcome.is_signed = key.has_value();
  outcome.verified = !certificate.issue->register_identity.empty();
  outcome.operators = describe(certificate.operators);
  return outcome;
}

AwaitedSignature prepare_to_sign(const IssueAsked& asked, Registered& registered, const Clock& clock) {
  (void)chosen_item(asked.run, asked.item);
  use_witness(registered);
  AwaitedSignature awaited;
  if (const auto known = record_kept_certificate(registered, asked, clock, awaited.warnings))
    throw std::invalid_argument(
        fmt::format("certificate {} is kept with the run; the register knows it now", *known));
  for (const std::string& run : runs_of_file(asked.run))
    if (RunFile::is_closed(run))
      if (const auto why = stamp_if_configured(run)) awaited.warnings.push_back(*why);
  const DccSchema schema = schema_of(asked.certificate);
  const Certificate certificate = numbered_certificate(asked, &registered, clock, awaited.warnings);
  awaited.prepared = prepare_certificate(certificate, &schema);
  awaited.files = asked.certificate;
  awaited.training = certificate.training();
  return awaited;
}

IssueOutcome issue_signed(const AwaitedSignature& awaited, const std::string& signed_xml,
                          Registered& registered, const Clock& clock) {
  use_witness(registered);
  const std::string pem = certificate_of_signature(awaited.prepared.issued.xml, signed_xml);
  require_own_key(registered, pem, Message("the signature"), clock.utc_now());
  const DccSchema schema = schema_of(awaited.files);
  IssueOutcome outcome;
  outcome.warnings = awaited.warnings;
  outcome.issued = keep_certificate(awaited.prepared, signed_xml, &schema, format_utc(clock.utc_now()));
  record_issued(registered, outcome.issued, clock, outcome.warnings);
  outcome.training = awaited.training;
  outcome.is_signed = outcome.verified = true;
  outcome.operators = outcome.issued.measured_by;
  return outcome;
}

std::optional<Message> why_not_approve(const lab::Person& approver, const StoredRun& run) {
  if (!approver.may(lab::Right::kApprove))
    return Message("{person} may not approve; required: a person with the right to approve", approver.name);
  for (const RunOperator& who : operators_of(run))
    if (who.name == approver.name)
      return Message("{person} has measured the run; required: another person who may approve",
                     approver.name);
  return std::nullopt;
}

}  // namespace abcal
