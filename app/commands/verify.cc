#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string_view>

#include "app/commands/commands.h"
#include "app/document/weasyprint.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/issuing/certificate_evidence.h"
#include "app/laboratory/issuing/run_evidence.h"
#include "app/laboratory/register/login.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/other_file.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "app/system/terminal.h"
#include "protocol/record/attestation.h"
#include "protocol/record/results_file.h"

namespace abcal {
namespace {

struct VerifyOptions {
  std::string run_file, register_location, pdf;
  std::vector<std::string> require, keys, authorities;
  bool json = false;

  bool demands(const std::string& what) const {
    return std::find(require.begin(), require.end(), what) != require.end();
  }
};

Trust trust_of(const VerifyOptions& options, lab::Register* opened) {
  Trust trust;
  for (const std::string& key : options.keys) trust.keys.push_back({key, read_file(key)});
  for (const std::string& authority : options.authorities) trust.authorities_pem += read_file(authority);
  if (opened != nullptr) std::ranges::move(bench_keys(*opened), std::back_inserter(trust.keys));
  return trust;
}

/// Adds a failed check for each requirement of --require that the run does not meet.
void add_required(const VerifyOptions& options, const Trust& trust, RunEvidence& evidence) {
  std::vector<IntegrityCheck>& checks = evidence.checks;
  if (options.demands("witnessed") && !evidence.is_witnessed)
    checks.push_back({"witnessed", false,
                      trust.keys.empty() ? "no key is trusted; --require witnessed requires statements by "
                                           "one: --key PUBLIC.pem, or a register with keys"
                                         : evidence.witness_words});
  if (options.demands("signed") && !evidence.is_signed)
    checks.push_back({"signed", false,
                      trust.keys.empty()
                          ? "no key is trusted; --require signed requires a signature by one: --key "
                            "PUBLIC.pem, or a register with keys"
                          : "there is no signature by a trusted key, which --require signed requires"});
  if (options.demands("timestamped") && !evidence.is_stamped)
    checks.push_back(
        {"timestamped", false,
         trust.authorities_pem.empty()
             ? "no authority is trusted; --require timestamped requires a time stamp by one: --authority "
               "CERTIFICATE.pem"
             : "there is no time stamp by a trusted authority, which --require timestamped requires"});
}

/// Columns of RUN.results that no chain, hash or signature covers.
constexpr std::array<std::string_view, 3> kNotCovered{
    "run.note (that results were made again)", "run.signer (the name; the key is checked by the signature)",
    "id of analysis and certificate (their numbering; their order is covered)"};

void print_checks(const std::vector<IntegrityCheck>& checks) {
  for (const IntegrityCheck& check : checks) {
    print_result(
        "{}  {}: {}\n",
        emphasised(stdout, check.good ? Emphasis::kGood : Emphasis::kBad, check.good ? "good" : " bad"),
        check.what, check.found);
  }
}

/// Checks a certificate that is there without its run: XML, or a PDF with the XML attached.
int verify_certificate(const VerifyOptions& options, const std::string& xml, lab::Register* opened) {
  if (!options.pdf.empty() || !options.require.empty() || !options.authorities.empty())
    throw std::invalid_argument(fmt::format(
        "{}: is a certificate; --pdf, --require and --authority are for a run", options.run_file));
  const CertificateEvidence evidence = judge_certificate(options.run_file, xml, opened);
  if (options.json) {
    nlohmann::ordered_json json{{"schema", "abcal.verify/1"}, {"good", evidence.is_good()}};
    json["certificate"] = evidence.number;
    if (!evidence.status.empty()) json["status"] = evidence.status;
    for (const IntegrityCheck& check : evidence.checks)
      json["checks"].push_back({{"what", check.what}, {"good", check.good}, {"found", check.found}});
    print_result("{}\n", json.dump(2));
  } else {
    print_checks(evidence.checks);
    print_result("{}\n", evidence.words);
  }
  return evidence.is_good() ? kExitDone : kExitFailed;
}

int verify(const VerifyOptions& options) {
  std::optional<lab::Register> opened;
  if (const std::string location = lab::register_location(options.register_location); !location.empty())
    opened = lab::Register::open(location, RealClock().utc_now());
  if (std::filesystem::is_regular_file(options.run_file)) {
    if (looks_like_xml(options.run_file))
      return verify_certificate(options, read_file(options.run_file, kLargestXml),
                                opened ? &*opened : nullptr);
    if (options.run_file.ends_with(".pdf"))
      return verify_certificate(options, attachment_of_pdf(options.run_file), opened ? &*opened : nullptr);
  }
  const Trust trust = trust_of(options, opened ? &*opened : nullptr);
  lab::Register* const known = opened ? &*opened : nullptr;
  const bool is_measurement = looks_like_measurement(options.run_file);
  if (is_measurement && !options.pdf.empty())
    throw std::invalid_argument(
        fmt::format("--pdf: {} is a measurement of several runs, which has no certificate; required: the run "
                    "that is certified",
                    options.run_file));
  RunEvidence evidence = is_measurement ? judge_measurement(options.run_file, trust, known)
                                        : judge_run(options.run_file, trust, known);
  add_required(options, trust, evidence);
  if (!options.pdf.empty()) {
    std::vector<PersonKey> keys;
    if (opened)
      for (const lab::SigningKey& key : opened->keys())
        if (key.kind == "person") keys.push_back({key.fingerprint, key.owner});
    std::ranges::move(
        check_printed_certificate(options.pdf, ResultsFile::certificates(options.run_file), keys),
        std::back_inserter(evidence.checks));
  }
  const std::vector<IntegrityCheck>& checks = evidence.checks;
  const bool good = evidence.is_good();
  if (options.json) {
    nlohmann::ordered_json json{{"schema", "abcal.verify/1"}, {"good", good}};
    if (good) json["attests"] = evidence.words;
    json["signed"] = evidence.is_signed;
    json["timestamped"] = evidence.is_stamped;
    json["witnessed"] = evidence.is_witnessed;
    json["not_covered"] = kNotCovered;
    for (const IntegrityCheck& check : checks)
      json["checks"].push_back({{"what", check.what}, {"good", check.good}, {"found", check.found}});
    print_result("{}\n", json.dump(2));
  } else {
    print_checks(checks);
    print_result("{}\n",
                 good ? evidence.words : "The run or its results were changed, or the run is not closed.");
    print_result("Not covered, in RUN.results: {}.\n", fmt::join(kNotCovered, "; "));
  }
  return good ? kExitDone : kExitFailed;
}

}  // namespace

CLI::App* add_verify(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<VerifyOptions>();
  CLI::App* command =
      parent.add_subcommand("verify",
                            "Check that a run and its results are consistent with their hashes and chains; "
                            "or a certificate: its signature, and with a register whether it holds");
  command->add_option("RUN", options->run_file, "run file or measurement; or a certificate, XML or PDF")
      ->required();
  command
      ->add_option("--require", options->require,
                   "witnessed, signed or timestamped, repeatable: fail without it")
      ->check(CLI::IsMember({"witnessed", "signed", "timestamped"}))
      ->allow_extra_args(false);
  command->add_option("--key", options->keys, "public key (PEM) of a trusted bench, repeatable")
      ->allow_extra_args(false);
  command
      ->add_option("--authority", options->authorities,
                   "certificate (PEM) of a trusted time-stamping authority, repeatable")
      ->allow_extra_args(false);
  command->add_option("--pdf", options->pdf,
                      "printed certificate of the run: check its signature (FILE.p7s) and the XML inside");
  command->add_option(
      "--register", options->register_location,
      "register whose keys are trusted and whose certificates are compared (default: ABCAL_REGISTER)");
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, &exit_code] { exit_code = verify(*options); });
  return command;
}

}  // namespace abcal
