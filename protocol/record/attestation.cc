#include "protocol/record/attestation.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"
#include "protocol/record/time_stamp.h"

namespace abcal {
namespace {

const TrustedKey* find_key(const Trust& trust, const std::string& public_pem) {
  for (const TrustedKey& key : trust.keys) {
    try {
      if (fingerprint_of(key.public_pem) == fingerprint_of(public_pem)) return &key;
    } catch (const std::invalid_argument&) {
      // No key: it matches nothing.
    }
  }
  return nullptr;
}

void check_signature(const RunSeal& seal, const std::string& sha256, const Trust& trust,
                     Attestation& attestation) {
  if (seal.signature.empty()) return;
  const std::string what = "signature";
  if (!is_signature(statement_of_run(sha256), seal.signature, seal.public_pem())) {
    attestation.checks.push_back(
        {what, false,
         fmt::format("it is not the signature of {} for the present content of the run",
                     seal.signer_name())});
    return;
  }
  const std::string by = fmt::format("by {}, key {}", seal.signer_name(), fingerprint_of(seal.public_pem()));
  const TrustedKey* key = find_key(trust, seal.public_pem());
  if (key == nullptr && !trust.keys.empty()) {
    attestation.checks.push_back({what, false, by + ", which is not one of the trusted keys"});
    return;
  }
  attestation.is_signed = key != nullptr;
  attestation.checks.push_back(
      {what, true, key == nullptr ? by + "; the owner of the key was not checked" : by});
}

void check_stamp(const RunSeal& seal, const std::string& sha256, const Trust& trust, Attestation& attestation,
                 TimeStampCheck& stamp) {
  if (seal.time_stamp.empty()) return;
  const std::string what = "time stamp";
  stamp = check_time_stamp(seal.time_stamp, sha256, trust.authorities_pem);
  if (trust.authorities_pem.empty()) {
    const bool of_this_run = stamp.for_this_hash;
    attestation.checks.push_back(
        {what, of_this_run,
         of_this_run ? fmt::format("{} by {}; the authority was not checked", stamp.utc, stamp.authority)
                     : "it is not for the present content of the run"});
    return;
  }
  attestation.is_stamped = stamp.good;
  attestation.checks.push_back({what, stamp.good,
                                stamp.good ? fmt::format("{} by {}", stamp.utc, stamp.authority)
                                           : fmt::format("it does not verify: {}", stamp.found)});
}

std::string words_of(const Attestation& attestation, const RunSeal& seal, const TimeStampCheck& stamp) {
  std::string words;
  if (attestation.is_stamped)
    words +=
        fmt::format("unchanged since {}, when the authority {} time-stamped it", stamp.utc, stamp.authority);
  if (attestation.is_signed)
    words += fmt::format(
        "{}signed by the key of {}: nobody without that key can have changed the run since it was closed",
        words.empty() ? "" : "; ", seal.signer_name());
  if (!words.empty() && !attestation.is_stamped)
    words += ". When it was signed is not attested, since there is no checked time stamp";
  if (!words.empty() && !attestation.is_signed)
    words += ". Who made it is not attested, since there is no checked signature";
  return words;
}

}  // namespace

Attestation attest(const std::filesystem::path& run, const Trust& trust) {
  Attestation attestation;
  if (!RunFile::is_closed(run)) {
    attestation.words = attested_by(run);
    return attestation;
  }
  const RunSeal seal = read_seal(run);
  const std::string sha256 = sha256_of_file(run);
  TimeStampCheck stamp;
  check_signature(seal, sha256, trust, attestation);
  check_stamp(seal, sha256, trust, attestation, stamp);
  attestation.words = words_of(attestation, seal, stamp);
  if (attestation.words.empty()) attestation.words = attested_by(run);
  return attestation;
}

}  // namespace abcal
