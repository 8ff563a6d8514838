#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "protocol/record/verify.h"

namespace abcal {

/// A public key that is trusted, and whose it is.
struct TrustedKey {
  std::string owner;
  std::string public_pem;
};

/// Against what signatures and time stamps are checked.
struct Trust {
  std::vector<TrustedKey> keys;  ///< Of benches.
  std::string authorities_pem;   ///< Certificates of time-stamping authorities, PEM.
};

/// What signature and time stamp of a run attest.
struct Attestation {
  std::vector<IntegrityCheck> checks;  ///< Of what is there: wrong ones are not good.
  bool is_signed = false;              ///< By a trusted key, and the signature is right.
  bool is_stamped = false;             ///< By a trusted authority, and the time stamp is right.
  std::string words;                   ///< What can be attested and what cannot, in one sentence.
};

/// Checks signature and time stamp beside a closed run against the bytes that the run has now.
Attestation attest(const std::filesystem::path& run, const Trust& trust);

}  // namespace abcal
