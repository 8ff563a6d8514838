#include <fmt/format.h>

#include <memory>
#include <optional>
#include <string>

#include "app/commands/certificate_options.h"
#include "app/commands/commands.h"
#include "app/commands/print_pdf.h"
#include "app/document/document_html.h"
#include "app/document/weasyprint.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/laboratory/issuing/issue_run.h"
#include "app/laboratory/register/login.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "app/system/temporary_folder.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

struct IssueOptions {
  IssueAsked asked;
  std::string dcc, pdf, register_location;
  bool force = false;
};

std::optional<Registered> open_registered(const IssueOptions& options, Clock::UtcTime now) {
  const std::string location = lab::register_location(options.register_location);
  if (location.empty()) {
    if (options.asked.number.empty() || options.asked.approved_by.empty())
      throw std::invalid_argument("issue: without a register: required: --number and --approved-by");
    return std::nullopt;
  }
  lab::Register opened = lab::Register::open(location, now);
  lab::LoggedIn approver = lab::require_login(opened, now);
  if (!options.asked.number.empty())
    throw std::invalid_argument("--number " + options.asked.number +
                                ": the register gives the numbers; leave it out");
  if (!options.asked.approved_by.empty() && options.asked.approved_by != approver.name())
    throw std::invalid_argument(
        fmt::format("--approved-by {}: {} is logged in, and approves for no other person",
                    options.asked.approved_by, approver.name()));
  return Registered{std::move(opened), std::move(approver)};
}

/// Writes the printed certificate and, if a key is given, its detached signature.
void write_printed(const IssueOptions& options, const std::string& xml) {
  PdfPrinter printer;
  const std::string page = document_html(certificate_page(xml));
  const TemporaryFolder folder;
  const Attachment attachment{folder / "certificate.xml", AttachmentKind::kData};
  OutputFile(attachment.file).write(xml);
  OutputFile pdf(options.pdf);
  print_pdf(printer, page, pdf.temporary(), attachment);
  pdf.commit();
  if (options.asked.key.empty()) return;
  OutputFile(signature_path_of(options.pdf))
      .write(sign_detached(read_file(options.pdf),
                           {read_file(options.asked.key), read_file(options.asked.key_certificate)}));
}

/// Reports all that can be foreseen before a number is given.
void check_outputs(const IssueOptions& options) {
  std::vector<RequestedOutput> requested;
  if (!options.dcc.empty()) requested.push_back({"--dcc", options.dcc});
  if (!options.pdf.empty()) {
    require_installed(kWeasyPrint);
    requested.push_back({"--pdf", options.pdf});
    if (!options.asked.key.empty()) requested.push_back({"--pdf, signature", signature_path_of(options.pdf)});
  }
  require_writable(requested, {options.asked.run, options.asked.certificate.laboratory}, options.force);
}

void print_issued(const IssueOptions& options, const IssueOutcome& outcome) {
  const IssuedCertificate& issued = outcome.issued;
  if (outcome.training) print_result("TRAINING: this certificate certifies nothing\n");
  print_result("certificate {} of {}{}: measured by {}, approved by {}{}\n", issued.number, issued.date,
               issued.item > 0 ? fmt::format(", item {}", issued.item) : "", outcome.operators,
               issued.approved_by, outcome.verified ? "" : fmt::format(" ({})", kNotVerified));
  if (!issued.replaces.empty()) print_result("it replaces {}: {}\n", issued.replaces, issued.reason);
  print_result("kept in {}{}; SHA-256 of its XML {}\n", ResultsFile::path_beside(options.asked.run).string(),
               outcome.is_signed ? ", signed" : "", sha256_of(issued.xml));
}

/// Shows what an amendment changes, before it has a number.
void print_changes(const std::vector<ChangedStatement>& changed) {
  print_result("the amendment changes {} statement{}\n", changed.size(), changed.size() == 1 ? "" : "s");
  for (const ChangedStatement& one : changed)
    print_result("  {}{}\n", one.administrative ? "" : "result or item: ", one.words());
}

void issue(const IssueOptions& options) {
  const RealClock clock;
  if (options.asked.key.empty() != options.asked.key_certificate.empty())
    throw std::invalid_argument("--sign KEY.pem and --certificate CERT.pem go together");
  check_outputs(options);
  std::optional<Registered> registered = open_registered(options, clock.utc_now());
  const IssueOutcome outcome = issue_run(options.asked, registered ? &*registered : nullptr, clock);
  for (const std::string& warning : outcome.warnings) print_warning(warning);
  if (!outcome.known_now.empty()) {
    print_result("certificate {} is kept with the run; the register knows it now\n", outcome.known_now);
    return;
  }
  if (!options.dcc.empty()) OutputFile(options.dcc).write(outcome.issued.xml);
  if (!options.pdf.empty()) write_printed(options, outcome.issued.xml);
  print_issued(options, outcome);
}

}  // namespace

CLI::App* add_issue(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<IssueOptions>();
  CLI::App* command = parent.add_subcommand(
      "issue",
      "Issue the calibration certificate of a complete run: approved, numbered, kept in RUN.results");
  command->add_option("RUN", options->asked.run, "run file")->required();
  command->add_option("--item", options->asked.item,
                      "of a run with several items: whose certificate, from 1; each has its own");
  add_certificate_options(*command, options->asked.certificate);
  command->get_option("--laboratory")->required();
  command->add_option(
      "--register", options->register_location,
      "register that gives the number; who is logged in there approves (default: ABCAL_REGISTER)");
  command->add_option("--number", options->asked.number,
                      "without a register: number of the certificate, unique");
  command->add_option("--approved-by", options->asked.approved_by,
                      "without a register: who approves it: a person of the laboratory file who may approve");
  command->add_option("--measured-by", options->asked.measured_by,
                      "must be who measured, as the events of the run say (default: they)");
  command->add_option("--date", options->asked.date, "date of issue, 2026-03-01 (default: today, UTC)");
  command->add_option("--replaces", options->asked.replaces,
                      "number of the certificate that this one amends");
  command->add_option("--reason", options->asked.reason, "why it is amended");
  command->add_option("--amendment", options->asked.amendment,
                      "administrative: no number, unit, uncertainty, verdict and nothing of the item may "
                      "change; technical: every change is listed on the certificate");
  command->add_option("--replaced", options->asked.replaced_xml,
                      "XML of the amended certificate, if it is of another run");
  command->add_option("--not-witnessed", options->asked.not_witnessed,
                      "the approver's statement why a run that was not witnessed is certified all the same; "
                      "it is printed on the certificate");
  command->add_option("--sign", options->asked.key,
                      "private key of the approver (PEM): sign the XML, and the PDF");
  command->add_option("--certificate", options->asked.key_certificate, "X.509 certificate of that key (PEM)");
  command->add_option("--dcc", options->dcc, "write the XML to this file as well");
  command->add_option("--pdf", options->pdf,
                      "write the printed certificate to this file as well; with --sign also its detached "
                      "signature, FILE.p7s");
  command->add_flag("--force", options->force, "overwrite a file that exists");
  options->asked.tell_changes = print_changes;
  command->callback([options, &exit_code] {
    issue(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
