#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <string_view>

#include "app/faces/commands/commands.h"
#include "app/ground/system/exit_code.h"
#include "app/ground/system/output.h"
#include "app/ground/system/read_file.h"
#include "app/ground/system/real_clock.h"
#include "app/ground/system/terminal.h"
#include "app/laboratory/certificate/series_files.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/register/login.h"
#include "app/results/estimates/recompute.h"
#include "protocol/record/attestation.h"
#include "protocol/record/results_file.h"
#include "protocol/record/sha256.h"

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
  if (opened != nullptr)
    for (const lab::SigningKey& key : opened->keys())
      if (key.kind == "bench" && key.valid_to.empty()) trust.keys.push_back({key.owner, key.public_pem});
  return trust;
}

/// Adds a failed check for each requirement of --require that the run does not meet.
void add_required(const VerifyOptions& options, const Trust& trust, const Attestation& attestation,
                  std::vector<IntegrityCheck>& checks) {
  if (options.demands("signed") && !attestation.is_signed)
    checks.push_back({"signed", false,
                      trust.keys.empty()
                          ? "no key is trusted; --require signed requires a signature by one: --key "
                            "PUBLIC.pem, or a register with keys"
                          : "there is no signature by a trusted key, which --require signed requires"});
  if (options.demands("timestamped") && !attestation.is_stamped)
    checks.push_back({"timestamped", false,
                      trust.authorities_pem.empty()
                          ? "no authority is trusted; --require timestamped requires a time stamp by one: "
                            "--authority CERTIFICATE.pem"
                          : "there is no time stamp by a trusted authority, which --require timestamped "
                            "requires"});
}

/// Compares the run's certificates with the register, and adds the register's own checks.
void compare_with_register(const VerifyOptions& options, lab::Register& opened,
                           std::vector<IntegrityCheck>& checks) {
  std::vector<lab::KeptCertificate> kept;
  for (const IssuedCertificate& one : ResultsFile::certificates(options.run_file))
    kept.push_back({one.number, sha256_of(one.xml)});
  const auto registered = opened.certificates_of(sha256_of_file(options.run_file));
  for (const lab::RegisterFinding& finding : lab::compare_with_run(registered, kept))
    checks.push_back({"register, " + finding.what, finding.good, finding.found});
  for (const lab::RegisterFinding& finding : opened.verify())
    checks.push_back({"register, " + finding.what, finding.good, finding.found});
}

/// The signatures of the run's certificates, and of a printed one; and the runs over temperature that they
/// name.
std::vector<IntegrityCheck> check_signatures(const VerifyOptions& options, lab::Register* opened) {
  std::vector<PersonKey> keys;
  if (opened != nullptr)
    for (const lab::SigningKey& key : opened->keys())
      if (key.kind == "person") keys.push_back({key.fingerprint, key.owner});
  const std::vector<IssuedCertificate> certificates = ResultsFile::certificates(options.run_file);
  std::vector<IntegrityCheck> checks = check_certificate_signatures(certificates, keys);
  const std::filesystem::path folder = std::filesystem::absolute(options.run_file).parent_path();
  for (IntegrityCheck& check : check_series_files(certificates, folder)) checks.push_back(std::move(check));
  if (options.pdf.empty()) return checks;
  for (IntegrityCheck& check : check_printed_certificate(options.pdf, certificates, keys))
    checks.push_back(std::move(check));
  return checks;
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

int verify(const VerifyOptions& options) {
  std::optional<lab::Register> opened;
  if (const std::string location = lab::register_location(options.register_location); !location.empty())
    opened = lab::Register::open(location, RealClock().utc_now());
  const Trust trust = trust_of(options, opened ? &*opened : nullptr);
  std::vector<IntegrityCheck> checks = verify_and_recompute(options.run_file);
  const Attestation attestation = attest(options.run_file, trust);
  checks.insert(checks.end(), attestation.checks.begin(), attestation.checks.end());
  add_required(options, trust, attestation, checks);
  const std::vector<IntegrityCheck> signatures = check_signatures(options, opened ? &*opened : nullptr);
  checks.insert(checks.end(), signatures.begin(), signatures.end());
  if (opened) compare_with_register(options, *opened, checks);

  const bool good =
      std::all_of(checks.begin(), checks.end(), [](const IntegrityCheck& check) { return check.good; });
  if (options.json) {
    nlohmann::ordered_json json{{"schema", "abcal.verify/1"}, {"good", good}};
    if (good) json["attests"] = attestation.words;
    json["signed"] = attestation.is_signed;
    json["timestamped"] = attestation.is_stamped;
    json["not_covered"] = kNotCovered;
    for (const IntegrityCheck& check : checks)
      json["checks"].push_back({{"what", check.what}, {"good", check.good}, {"found", check.found}});
    print_result("{}\n", json.dump(2));
  } else {
    print_checks(checks);
    print_result("{}\n",
                 good ? attestation.words : "The run or its results were changed, or the run is not closed.");
    print_result("Not covered, in RUN.results: {}.\n", fmt::join(kNotCovered, "; "));
  }
  return good ? kExitDone : kExitFailed;
}

}  // namespace

CLI::App* add_verify(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<VerifyOptions>();
  CLI::App* command = parent.add_subcommand(
      "verify", "Check that a run and its results are consistent with their hashes and chains");
  command->add_option("RUN", options->run_file, "run file")->required();
  command->add_option("--require", options->require, "signed or timestamped, repeatable: fail without it")
      ->check(CLI::IsMember({"signed", "timestamped"}))
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
