#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "protocol/record/verify_run.h"

namespace abcal {

/// A trusted public key, and its owner.
struct TrustedKey {
  std::string owner;
  std::string public_pem;
};

/// Keys and certificates that signatures and time stamps are checked against.
struct Trust {
  std::vector<TrustedKey> keys;  ///< Keys of benches.
  std::string authorities_pem;   ///< Certificates of time-stamping authorities, PEM.
};

/// Result of checking the signature and the time stamp of a run.
struct Attestation {
  std::vector<IntegrityCheck> checks;  ///< Checks of the existing parts; an invalid part is not good.
  bool is_signed = false;              ///< A trusted key made the signature, and it is valid.
  bool is_stamped = false;             ///< A trusted authority issued the time stamp, and it is valid.
  std::string words;                   ///< Attested and unattested facts, in one sentence.
};

/// Checks the signature and the time stamp of a closed run against its present bytes.
Attestation attest(const std::filesystem::path& run, const Trust& trust);

}  // namespace abcal
