#include "app/laboratory/issuing/run_evidence.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "app/laboratory/certificate/series_files.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/issuing/evidence_files.h"
#include "app/laboratory/register/find_operator.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/recompute.h"
#include "app/witness/witness_check.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

void append(std::vector<IntegrityCheck> more, std::vector<IntegrityCheck>& checks) {
  std::ranges::move(more, std::back_inserter(checks));
}

/// The signatures of the run's certificates, and the runs over temperature that they name.
void add_certificates(const std::filesystem::path& run, lab::Register* opened,
                      std::vector<IntegrityCheck>& checks) {
  std::vector<PersonKey> keys;
  if (opened != nullptr)
    for (const lab::SigningKey& key : opened->keys())
      if (key.kind == "person") keys.push_back({key.fingerprint, key.owner});
  const std::vector<IssuedCertificate> certificates = ResultsFile::certificates(run);
  append(check_certificate_signatures(certificates, keys), checks);
  append(check_series_files(certificates, std::filesystem::absolute(run).parent_path()), checks);
}

/// Compares the run's certificates with the register, and adds the register's own checks.
void compare_with_register(const std::filesystem::path& run, lab::Register& opened,
                           std::vector<IntegrityCheck>& checks) {
  std::vector<lab::KeptCertificate> kept;
  for (const IssuedCertificate& one : ResultsFile::certificates(run)) {
    kept.push_back({one.number, sha256_of(one.xml)});
    const std::string name = "certificate " + one.number;
    try {
      if (const auto finding = opened.compare_audit_with(evidence_of_certificate(name, one.xml)))
        checks.push_back({"register against " + finding->what, finding->good, finding->found});
    } catch (const std::invalid_argument& error) {
      checks.push_back({"register against " + name, false, error.what()});
    }
  }
  const auto registered = opened.certificates_of(sha256_of_file(run));
  for (const lab::RegisterFinding& finding : lab::compare_with_run(registered, kept))
    checks.push_back({"register, " + finding.what, finding.good, finding.found});
  // A run whose certificate was amended or withdrawn is as whole as before.
  for (const lab::CertificateRecord& one : registered)
    if (const auto status = opened.status_of(one.number))
      checks.push_back({"register, status of certificate " + one.number, true, status->words()});
  for (const lab::RegisterFinding& finding : opened.verify())
    checks.push_back({"register, " + finding.what, finding.good, finding.found});
}

bool has_issued_certificate(const std::filesystem::path& run, lab::Register& opened) {
  return std::ranges::count(opened.certificates_of(sha256_of_file(run)), "issued",
                            &lab::CertificateRecord::state) > 0;
}

/// Compares what the run says of the register with what the register says itself: anybody can make a register
/// with its name. The register knows that the operator was logged in, as that login told it of the run.
void check_words_about_register(const std::filesystem::path& run, lab::Register& opened,
                                std::vector<IntegrityCheck>& checks) {
  if (has_issued_certificate(run, opened))
    return;  // It was accepted then, and the register names its SHA-256.
  const StoredRun stored = RunFile::load(run);
  std::vector<std::string> logged_in;
  for (const RunOperator& who : operators_of(stored))
    if (who.register_identity == opened.facts().identity) logged_in.push_back(who.name);
  if (logged_in.empty()) return;
  const std::string told_by = opened.told_by(sha256_of_file(run));
  const bool is_told = std::ranges::find(logged_in, told_by) != logged_in.end();
  checks.push_back(
      {"register, operator", is_told,
       is_told
           ? fmt::format("{} was logged in to this register, which was told of the run", told_by)
           : fmt::format(
                 "the run says that {} was logged in to this register, which {}; required: a run that "
                 "was measured with it, or `abcal lab add run {}` by who measured it",
                 fmt::join(logged_in, ", "),
                 told_by.empty() ? "does not know the run" : "was told of it by " + told_by, run.string())});
  const auto label = stored.header.labels.find(kCalibrationsLabel);
  if (label == stored.header.labels.end()) return;
  const std::vector<std::string> unknown = unknown_calibrations(opened, label->second);
  checks.push_back({"register, calibrations", unknown.empty(),
                    unknown.empty() ? "those that the run states are in the register"
                                    : fmt::format("the run states {}, which the register does not have so",
                                                  fmt::join(unknown, ", "))});
}

}  // namespace

bool RunEvidence::is_good() const {
  return std::ranges::all_of(checks, &IntegrityCheck::good);
}

std::vector<TrustedKey> bench_keys(lab::Register& opened) {
  std::vector<TrustedKey> keys;
  for (const lab::SigningKey& key : opened.keys())
    if (key.kind == "bench" && key.valid_to.empty()) keys.push_back({key.owner, key.public_pem});
  return keys;
}

std::string missing_witness(const RunEvidence& evidence, lab::Register& opened) {
  if (bench_keys(opened).empty() || evidence.is_witnessed) return {};
  if (opened.facts().training && evidence.is_simulated && evidence.is_signed) return {};
  return fmt::format("{}; the register holds the key of a bench and requires that each angle is witnessed",
                     evidence.witness_words);
}

RunEvidence judge_run(const std::filesystem::path& run, const Trust& trust, lab::Register* opened) {
  RunEvidence evidence;
  evidence.checks = verify_and_recompute(run);
  Attestation attestation = attest(run, trust);
  append(std::move(attestation.checks), evidence.checks);
  WitnessCheck witness = check_witness(run, trust);
  append(std::move(witness.checks), evidence.checks);
  evidence.is_signed = attestation.is_signed || witness.is_signed;
  evidence.is_stamped = attestation.is_stamped;
  evidence.is_witnessed = witness.is_witnessed;
  evidence.is_simulated = witness.is_simulated;
  evidence.witness = std::move(witness.signer);
  evidence.angles = witness.angles;
  evidence.witness_words = std::move(witness.words);
  evidence.words =
      evidence.is_witnessed || witness.is_signed
          ? fmt::format("{}: nobody without that key can have changed what it has signed{}",
                        evidence.witness_words, attestation.is_stamped ? "; " + attestation.words : "")
          : attestation.words;
  add_certificates(run, opened, evidence.checks);
  if (opened == nullptr) return evidence;
  compare_with_register(run, *opened, evidence.checks);
  check_words_about_register(run, *opened, evidence.checks);
  if (const std::string missing = missing_witness(evidence, *opened); !missing.empty()) {
    const bool is_registered = has_issued_certificate(run, *opened);
    evidence.checks.push_back(
        {kWitnessRequired, is_registered,
         is_registered ? missing + "; its certificate was issued before, and the register names its SHA-256"
                       : missing});
  }
  return evidence;
}

RunEvidence judge_measurement(const std::filesystem::path& measurement, const Trust& trust,
                              lab::Register* opened) {
  const AnalysedRun analysed = analyse_file(measurement);  // Each file is found by its SHA-256.
  RunEvidence all;
  all.checks = check_analyses(measurement, analysed);
  all.is_signed = all.is_stamped = all.is_witnessed = true;
  for (const RunOfMeasurement& run : analysed.runs) {
    RunEvidence evidence = judge_run(run.file, trust, opened);
    const std::string name = std::filesystem::path(run.file).filename().string();
    all.is_signed = all.is_signed && evidence.is_signed;
    all.is_stamped = all.is_stamped && evidence.is_stamped;
    all.is_witnessed = all.is_witnessed && evidence.is_witnessed;
    all.is_simulated = all.is_simulated || evidence.is_simulated;
    all.angles += evidence.angles;
    for (IntegrityCheck& check : evidence.checks) {
      check.what = fmt::format("{}, {}", name, check.what);
      all.checks.push_back(std::move(check));
    }
    all.words += fmt::format("{}{}: {}", all.words.empty() ? "" : "\n", name, evidence.words);
    all.witness_words +=
        fmt::format("{}{}: {}", all.witness_words.empty() ? "" : "; ", name, evidence.witness_words);
  }
  add_certificates(measurement, opened, all.checks);
  if (opened != nullptr) compare_with_register(measurement, *opened, all.checks);
  return all;
}

}  // namespace abcal
