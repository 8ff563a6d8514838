#include "app/laboratory/issuing/issue_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "app/ground/evidence/time_stamp_authority.h"
#include "app/ground/system/interrupt.h"
#include "app/ground/system/read_file.h"
#include "app/laboratory/certificate/certificate.h"
#include "app/laboratory/certificate/issue.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/laboratory/compare/check_chart.h"
#include "app/results/estimates/load_record.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

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
  if (asked.replaces.empty() != asked.reason.empty())
    throw std::invalid_argument("--replaces NUMBER and --reason TEXT go together");
  if (asked.replaces.empty()) return facts;
  facts.replaces = Replacement{asked.replaces, asked.reason, {}};
  for (const IssuedCertificate& issued : ResultsFile::certificates(asked.run, asked.item))
    if (issued.number == asked.replaces) facts.replaces->sha256 = sha256_of(issued.xml);
  return facts;
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

void use_register(Registered& registered, CertificateRequest& request) {
  IssueFacts& facts = *request.issue;
  facts.number = "as the register gives it";
  facts.approved_by = registered.approver.name();
  facts.register_identity = registered.opened.facts().identity;
  facts.training = registered.opened.facts().training;
  request.laboratory.file.persons = persons_of(registered.opened);
  request.laboratory.file.scope = scope_of(registered.opened);
}

/// Completes an issue whose program ended after the certificate was kept with the run and before it was
/// registered.
/// @return its number; absent: this was not the case
std::optional<std::string> record_kept_certificate(Registered& registered, const IssueAsked& asked,
                                                   Clock::UtcTime now) {
  const auto kept = ResultsFile::certificates(asked.run, asked.item);
  for (const lab::CertificateRecord& one : registered.opened.certificates_of(sha256_of_file(asked.run))) {
    const auto found = std::find_if(kept.begin(), kept.end(), [&](const IssuedCertificate& issued) {
      return issued.number == one.number;
    });
    if (one.state != "reserved" || found == kept.end()) continue;
    registered.opened.record_issued(registered.approver, one.number, sha256_of(found->xml), found->date, now);
    return one.number;
  }
  return std::nullopt;
}

/// The name of an item in the register; no two items of a run have the same.
std::string item_name(const ReportData& data) {
  return fmt::format("{} {} {}", data.label("item.maker"), data.label("item.model"),
                     data.label("item.serial_number"));
}

void take_number(Registered& registered, Certificate& certificate, Clock::UtcTime now) {
  const ReportData& data = certificate.run.data;
  lab::NumberRequest request;
  request.run_sha256 = data.sha256.value();
  request.item = item_name(data);
  request.measured_by = certificate.measured_by();
  const BenchIdentity bench = subject_of(*data.run).bench;
  request.stage = bench.stage;
  request.bench = bench.name;
  if (const auto& replaced = certificate.issue->replaces) {
    request.replaces = replaced->number;
    request.reason = replaced->reason;
  }
  certificate.number = certificate.issue->number =
      registered.opened.reserve_number(registered.approver, request, now);
}

/// With a register, an approver signs with a key of their own that the register knows.
/// @param from  where the certificate of the key comes from, for messages
void require_own_key(Registered& registered, const std::string& certificate_pem, const std::string& from,
                     Clock::UtcTime now) {
  const CertificateSubject subject = subject_of(certificate_pem);
  const std::string fingerprint = fingerprint_of(subject.public_pem), today = format_utc(now);
  const std::string& approver = registered.approver.name();
  for (const lab::SigningKey& key : registered.opened.keys()) {
    if (key.fingerprint != fingerprint || key.kind != "person" || key.owner != approver) continue;
    if (!key.valid_to.empty())
      throw std::invalid_argument(
          fmt::format("{}: the key of \"{}\" was retired on {}; required: a key that is valid", from,
                      subject.name, key.valid_to));
    if (today < subject.valid_from_utc || today > subject.valid_to_utc)
      throw std::invalid_argument(fmt::format(
          "{}: the certificate of \"{}\" is valid from {} to {}; required: one that is valid today", from,
          subject.name, subject.valid_from_utc, subject.valid_to_utc));
    return;
  }
  throw std::invalid_argument(fmt::format(
      "{}: the key of \"{}\", which is none of {}'s in the register; required: a key of the approver's own "
      "(abcal lab key \"{}\" --kind person --certificate FILE)",
      from, subject.name, approver, approver));
}

/// The certificate of a complete run, with its number.
Certificate numbered_certificate(const IssueAsked& asked, Registered* registered, Clock::UtcTime now) {
  CertificateRequest request;
  request.laboratory = read_laboratory_file(asked.certificate.laboratory);
  if (!asked.certificate.language.empty()) request.laboratory.file.language = asked.certificate.language;
  request.run = gather_report(asked.run, now, asked.item);
  if (!asked.certificate.as_found.empty())
    request.as_found = gather_same_item("--as-found", asked.certificate.as_found, request.run, now);
  request.series = gather_series(asked.certificate.temperature, request.run, now);
  request.issue = facts_of(asked, format_utc(now));
  if (registered != nullptr) use_register(*registered, request);
  Certificate certificate = make_certificate(std::move(request));
  end_orderly_at_signals();  // A certificate that has its number must be kept, registered and written.
  if (registered != nullptr) take_number(*registered, certificate, now);
  return certificate;
}

}  // namespace

IssueOutcome issue_run(const IssueAsked& asked, Registered* registered, Clock::UtcTime now) {
  (void)chosen_item(asked.run, asked.item);
  IssueOutcome outcome;
  if (asked.key.empty() != asked.key_certificate.empty())
    throw std::invalid_argument("--sign KEY.pem and --certificate CERT.pem go together");
  if (registered != nullptr) {
    if (auto known = record_kept_certificate(*registered, asked, now)) {
      outcome.known_now = *std::move(known);
      return outcome;
    }
    if (!asked.key.empty())
      require_own_key(*registered, read_file(asked.key_certificate), "--certificate " + asked.key_certificate,
                      now);
  }
  if (RunFile::is_closed(asked.run))
    if (const auto why = stamp_if_configured(asked.run)) outcome.warnings.push_back(*why);
  const DccSchema schema = schema_of(asked.certificate);
  const Certificate certificate = numbered_certificate(asked, registered, now);
  std::optional<SigningKey> key;
  if (!asked.key.empty()) key = SigningKey{asked.key, asked.key_certificate};
  outcome.issued = issue_certificate(certificate, &schema, key, format_utc(now));
  if (registered != nullptr)
    registered->opened.record_issued(registered->approver, outcome.issued.number,
                                     sha256_of(outcome.issued.xml), outcome.issued.date, now);
  outcome.training = certificate.training();
  outcome.is_signed = key.has_value();
  outcome.verified = !certificate.issue->register_identity.empty();
  outcome.operators = describe(certificate.operators);
  return outcome;
}

AwaitedSignature prepare_to_sign(const IssueAsked& asked, Registered& registered, Clock::UtcTime now) {
  (void)chosen_item(asked.run, asked.item);
  if (const auto known = record_kept_certificate(registered, asked, now))
    throw std::invalid_argument(
        fmt::format("certificate {} is kept with the run; the register knows it now", *known));
  AwaitedSignature awaited;
  if (RunFile::is_closed(asked.run))
    if (const auto why = stamp_if_configured(asked.run)) awaited.warnings.push_back(*why);
  const DccSchema schema = schema_of(asked.certificate);
  const Certificate certificate = numbered_certificate(asked, &registered, now);
  awaited.prepared = prepare_certificate(certificate, &schema);
  awaited.files = asked.certificate;
  awaited.training = certificate.training();
  return awaited;
}

IssueOutcome issue_signed(const AwaitedSignature& awaited, const std::string& signed_xml,
                          Registered& registered, Clock::UtcTime now) {
  const std::string pem = certificate_of_signature(awaited.prepared.issued.xml, signed_xml);
  require_own_key(registered, pem, "the signature", now);
  const DccSchema schema = schema_of(awaited.files);
  IssueOutcome outcome;
  outcome.issued = keep_certificate(awaited.prepared, signed_xml, &schema, format_utc(now));
  registered.opened.record_issued(registered.approver, outcome.issued.number, sha256_of(outcome.issued.xml),
                                  outcome.issued.date, now);
  outcome.training = awaited.training;
  outcome.is_signed = outcome.verified = true;
  outcome.operators = outcome.issued.measured_by;
  outcome.warnings = awaited.warnings;
  return outcome;
}

std::optional<std::string> why_not_approve(const lab::Person& approver, const StoredRun& run) {
  if (!approver.may(lab::Right::kApprove))
    return fmt::format("{} may not approve; required: a person with the right to approve", approver.name);
  for (const RunOperator& who : operators_of(run))
    if (who.name == approver.name)
      return fmt::format("{} has measured the run; required: another person who may approve", approver.name);
  return std::nullopt;
}

}  // namespace abcal
