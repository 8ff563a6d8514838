#include <fmt/format.h>

#include <algorithm>
#include <memory>
#include <optional>

#include "app/bench/real_clock.h"
#include "app/certificate/certificate_page.h"
#include "app/certificate/issue.h"
#include "app/certificate/signature_checks.h"
#include "app/certificate/signing_certificate.h"
#include "app/commands/certificate_options.h"
#include "app/commands/commands.h"
#include "app/compare/check_chart.h"
#include "app/document/document_html.h"
#include "app/document/weasyprint.h"
#include "app/laboratory/login.h"
#include "app/session/time_stamp_authority.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/temporary_folder.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

struct IssueOptions {
  std::string run, number, measured_by, approved_by, date, replaces, reason, dcc, pdf, key, key_certificate,
      register_location;
  bool force = false;
  CertificateFiles certificate;
};

/// The register that gives the number, and who approves. Nothing: there is no register.
struct Registered {
  lab::Register opened;
  lab::LoggedIn approver;
};

std::optional<Registered> open_registered(const IssueOptions& options, Clock::UtcTime now) {
  const std::string location = lab::register_location(options.register_location);
  if (location.empty()) {
    if (options.number.empty() || options.approved_by.empty())
      throw std::invalid_argument("issue: without a register: required: --number and --approved-by");
    return std::nullopt;
  }
  lab::Register opened = lab::Register::open(location, now);
  lab::LoggedIn approver = lab::require_login(opened, now);
  if (!options.number.empty())
    throw std::invalid_argument("--number " + options.number +
                                ": the register gives the numbers; leave it out");
  if (!options.approved_by.empty() && options.approved_by != approver.name())
    throw std::invalid_argument(
        fmt::format("--approved-by {}: {} is logged in, and approves for no other person",
                    options.approved_by, approver.name()));
  return Registered{std::move(opened), std::move(approver)};
}

IssueFacts facts_of(const IssueOptions& options, const std::string& now_utc) {
  IssueFacts facts;
  facts.number = options.number;
  facts.measured_by = options.measured_by;
  facts.approved_by = options.approved_by;
  facts.today = parse_date(now_utc);
  const auto date = parse_date(options.date.empty() ? now_utc : options.date);
  if (!date || (!options.date.empty() && options.date.size() != 10))
    throw std::invalid_argument("--date " + options.date + ": required: a date, 2026-03-01");
  facts.date = *date;
  if (options.replaces.empty() != options.reason.empty())
    throw std::invalid_argument("--replaces NUMBER and --reason TEXT go together");
  if (options.replaces.empty()) return facts;
  facts.replaces = Replacement{options.replaces, options.reason, {}};
  for (const IssuedCertificate& issued : ResultsFile::certificates(options.run))
    if (issued.number == options.replaces) facts.replaces->sha256 = sha256_of(issued.xml);
  return facts;
}

/// The persons of the register take the place of those of the laboratory file.
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

/// The scope of the register takes the place of that of the laboratory file.
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

/// The program ended after the certificate was kept with the run and before the register knew: it is told
/// now.
/// @return whether that was so
bool record_kept_certificate(Registered& registered, const IssueOptions& options, Clock::UtcTime now) {
  const auto kept = ResultsFile::certificates(options.run);
  for (const lab::CertificateRecord& one : registered.opened.certificates_of(sha256_of_file(options.run))) {
    const auto found = std::find_if(kept.begin(), kept.end(), [&](const IssuedCertificate& issued) {
      return issued.number == one.number;
    });
    if (one.state != "reserved" || found == kept.end()) continue;
    registered.opened.record_issued(registered.approver, one.number, sha256_of(found->xml), found->date, now);
    print_result("certificate {} is kept with the run; the register knows it now\n", one.number);
    return true;
  }
  return false;
}

void take_number(Registered& registered, Certificate& certificate, Clock::UtcTime now) {
  const ReportData& data = certificate.run.data;
  lab::NumberRequest request;
  request.run_sha256 = data.sha256.value();
  request.item = fmt::format("{} {} {}", data.label("item.maker"), data.label("item.model"),
                             data.label("item.serial_number"));
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
void require_own_key(Registered& registered, const std::string& certificate_file) {
  const CertificateSubject subject = subject_of(read_file(certificate_file));
  const std::string fingerprint = fingerprint_of(subject.public_pem);
  const std::string& approver = registered.approver.name();
  for (const lab::SigningKey& key : registered.opened.keys())
    if (key.fingerprint == fingerprint && key.kind == "person" && key.owner == approver &&
        key.valid_to.empty())
      return;
  throw std::invalid_argument(fmt::format(
      "--certificate {}: the key of \"{}\", which is none of {}'s in the register; required: a key of the "
      "approver's own (abcal lab key \"{}\" --kind person --certificate FILE)",
      certificate_file, subject.name, approver, approver));
}

/// The printed certificate, and beside it its detached signature where there is a key.
void write_printed(const IssueOptions& options, const std::string& xml) {
  const HtmlPage page = document_html(certificate_page(xml));
  const TemporaryFolder folder;
  const Attachment attachment{folder / "certificate.xml", AttachmentKind::kData};
  OutputFile(attachment.file).write(xml);
  OutputFile pdf(options.pdf);
  print_pdf(page.html, pdf.temporary(), attachment);
  pdf.commit();
  if (options.key.empty()) return;
  OutputFile(signature_path_of(options.pdf))
      .write(sign_detached(read_file(options.pdf),
                           {read_file(options.key), read_file(options.key_certificate)}));
}

/// Reports all that can be foreseen before a number is given.
void check_outputs(const IssueOptions& options) {
  std::vector<RequestedOutput> requested;
  if (!options.dcc.empty()) requested.push_back({"--dcc", options.dcc});
  if (!options.pdf.empty()) {
    require_installed(kWeasyPrint);
    requested.push_back({"--pdf", options.pdf});
    if (!options.key.empty()) requested.push_back({"--pdf, signature", signature_path_of(options.pdf)});
  }
  require_writable(requested, {options.run, options.certificate.laboratory}, options.force);
}

void print_issued(const IssueOptions& options, const Certificate& certificate,
                  const IssuedCertificate& issued, bool is_signed) {
  if (certificate.training()) print_result("TRAINING: this certificate certifies nothing\n");
  print_result("certificate {} of {}: measured by {}, approved by {}{}\n", issued.number, issued.date,
               describe(certificate.operators), issued.approved_by,
               certificate.issue->register_identity.empty() ? fmt::format(" ({})", kNotVerified) : "");
  if (!issued.replaces.empty()) print_result("it replaces {}: {}\n", issued.replaces, issued.reason);
  print_result("kept in {}{}; SHA-256 of its XML {}\n", ResultsFile::path_beside(options.run).string(),
               is_signed ? ", signed" : "", sha256_of(issued.xml));
}

void issue(const IssueOptions& options) {
  const Clock::UtcTime now = RealClock().utc_now();
  if (options.key.empty() != options.key_certificate.empty())
    throw std::invalid_argument("--sign KEY.pem and --certificate CERT.pem go together");
  check_outputs(options);
  std::optional<Registered> registered = open_registered(options, now);
  if (registered && record_kept_certificate(*registered, options, now)) return;
  if (registered && !options.key.empty()) require_own_key(*registered, options.key_certificate);
  if (RunFile::is_closed(options.run))
    if (const auto why = stamp_if_configured(options.run)) print_warning(*why);
  CertificateRequest request;
  request.laboratory = read_laboratory_file(options.certificate.laboratory);
  if (!options.certificate.language.empty()) request.laboratory.file.language = options.certificate.language;
  request.run = gather_report(options.run, now);
  if (!options.certificate.as_found.empty())
    request.as_found = gather_report(options.certificate.as_found, now);
  request.issue = facts_of(options, format_utc(now));
  if (registered) use_register(*registered, request);
  Certificate certificate = make_certificate(std::move(request));

  const DccSchema schema = schema_of(options.certificate);
  std::optional<SigningKey> key;
  if (!options.key.empty()) key = SigningKey{options.key, options.key_certificate};
  if (registered) take_number(*registered, certificate, now);
  const IssuedCertificate issued = issue_certificate(certificate, &schema, key, format_utc(now));
  if (registered)
    registered->opened.record_issued(registered->approver, issued.number, sha256_of(issued.xml), issued.date,
                                     now);
  if (!options.dcc.empty()) OutputFile(options.dcc).write(issued.xml);
  if (!options.pdf.empty()) write_printed(options, issued.xml);
  print_issued(options, certificate, issued, key.has_value());
}

}  // namespace

CLI::App* add_issue(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<IssueOptions>();
  CLI::App* command = parent.add_subcommand(
      "issue",
      "Issue the calibration certificate of a complete run: approved, numbered, kept in RUN.results");
  command->add_option("RUN", options->run, "run file")->required();
  add_certificate_options(*command, options->certificate);
  command->get_option("--laboratory")->required();
  command->add_option(
      "--register", options->register_location,
      "register that gives the number; who is logged in there approves (default: ABCAL_REGISTER)");
  command->add_option("--number", options->number, "without a register: number of the certificate, unique");
  command->add_option("--approved-by", options->approved_by,
                      "without a register: who approves it: a person of the laboratory file who may approve");
  command->add_option("--measured-by", options->measured_by,
                      "must be who measured, as the events of the run say (default: they)");
  command->add_option("--date", options->date, "date of issue, 2026-03-01 (default: today, UTC)");
  command->add_option("--replaces", options->replaces, "number of the certificate that this one amends");
  command->add_option("--reason", options->reason, "why it is amended");
  command->add_option("--sign", options->key, "private key of the approver (PEM): sign the XML, and the PDF");
  command->add_option("--certificate", options->key_certificate, "X.509 certificate of that key (PEM)");
  command->add_option("--dcc", options->dcc, "write the XML to this file as well");
  command->add_option("--pdf", options->pdf,
                      "write the printed certificate to this file as well; with --sign also its detached "
                      "signature, FILE.p7s");
  command->add_flag("--force", options->force, "overwrite a file that exists");
  command->callback([options, &exit_code] {
    issue(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
