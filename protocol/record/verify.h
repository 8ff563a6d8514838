#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace abcal {

/// One thing that was looked at.
struct IntegrityCheck {
  std::string what;
  bool good = false;
  std::string found;  ///< In words.
};

/// Whether a closed run and its results are as they were written: every byte of the run by its SHA-256, which
/// the results name; the event log, the dwells with their readings, the analyses and the certificates by
/// their hash chains; means, spreads, standard uncertainties and flags by computing them again from the
/// readings. A run that is not closed has no hash yet, which is said and is not good. Files of version 2
/// chain no dwells.
/// @throws RunFileError if the file is no run file at all.
std::vector<IntegrityCheck> verify_run(const std::filesystem::path& run);

/// What the checks of verify_run() can attest where all are good, and what they cannot, in one sentence.
std::string attested_by(const std::filesystem::path& run);

}  // namespace abcal
