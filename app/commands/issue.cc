#include <fmt/format.h>

#include <memory>

#include "app/bench/real_clock.h"
#include "app/certificate/issue.h"
#include "app/commands/certificate_options.h"
#include "app/commands/commands.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

struct IssueOptions {
  std::string run, number, measured_by, approved_by, date, replaces, reason, dcc, key, key_certificate;
  bool force = false;
  CertificateFiles certificate;
};

IssueFacts facts_of(const IssueOptions& options, const std::string& now_utc) {
  IssueFacts facts;
  facts.number = options.number;
  facts.measured_by = options.measured_by;
  facts.approved_by = options.approved_by;
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

void issue(const IssueOptions& options) {
  const Clock::UtcTime now = RealClock().utc_now();
  if (options.key.empty() != options.key_certificate.empty())
    throw std::invalid_argument("--sign KEY.pem and --certificate CERT.pem go together");
  if (!options.dcc.empty())
    require_writable({{"--dcc", options.dcc}}, {options.run, options.certificate.laboratory}, options.force);
  CertificateRequest request;
  request.laboratory = read_laboratory_file(options.certificate.laboratory);
  request.run = gather_report(options.run, now);
  if (!options.certificate.as_found.empty())
    request.as_found = gather_report(options.certificate.as_found, now);
  request.issue = facts_of(options, format_utc(now));
  const Certificate certificate = make_certificate(std::move(request));

  const std::optional<DccSchema> schema = schema_of(options.certificate);
  if (!schema) print_note(kNotValidated);
  std::optional<SigningKey> key;
  if (!options.key.empty()) key = SigningKey{options.key, options.key_certificate};
  const IssuedCertificate issued =
      issue_certificate(certificate, schema ? &*schema : nullptr, key, format_utc(now));
  if (!options.dcc.empty()) OutputFile(options.dcc).write(issued.xml);
  print_result("certificate {} of {}: measured by {}, approved by {}\n", issued.number, issued.date,
               issued.measured_by, issued.approved_by);
  if (!issued.replaces.empty()) print_result("it replaces {}: {}\n", issued.replaces, issued.reason);
  print_result("kept in {}{}; SHA-256 of its XML {}\n", ResultsFile::path_beside(options.run).string(),
               key ? ", signed" : "", sha256_of(issued.xml));
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
  command->add_option("--number", options->number, "number of the certificate, unique")->required();
  command
      ->add_option("--approved-by", options->approved_by,
                   "who approves it: a person of the laboratory file who may approve")
      ->required();
  command->add_option("--measured-by", options->measured_by,
                      "who measured (default: the operator of the run)");
  command->add_option("--date", options->date, "date of issue, 2026-03-01 (default: today, UTC)");
  command->add_option("--replaces", options->replaces, "number of the certificate that this one amends");
  command->add_option("--reason", options->reason, "why it is amended");
  command->add_option("--sign", options->key, "private key (PEM): sign the XML");
  command->add_option("--certificate", options->key_certificate, "X.509 certificate of that key (PEM)");
  command->add_option("--dcc", options->dcc, "write the XML to this file as well");
  command->add_flag("--force", options->force, "overwrite a file that exists");
  command->callback([options, &exit_code] {
    issue(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
