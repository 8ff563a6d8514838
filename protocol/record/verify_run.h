#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace abcal {

/// One check and its outcome.
struct IntegrityCheck {
  std::string what;
  bool good = false;
  std::string found;  ///< In words.
  int item = 0;       ///< With several items: the item concerned, from 1; 0: the run.
};

/// Whether a closed run and its results are consistent with each other: every byte of the run by its SHA-256,
/// which the results name; the event log, the dwells with their readings, the analyses and the certificates
/// by their hash chains; means, spreads, standard uncertainties and flags by computing them again from the
/// readings. A run that is not closed has no hash yet: that check is not good. Files of version 2
/// chain no dwells.
/// @throws RunFileError if the file is not a run file.
std::vector<IntegrityCheck> verify_run(const std::filesystem::path& run);

/// Checks a run that is to be continued or closed: its chains, and that its means, spreads, standard
/// uncertainties and flags follow from its readings.
/// @throws RunFileError that names what was changed, with the angle
void require_unchanged(const std::filesystem::path& run);

/// The same checks of a run that is to give a result, and that its bytes have the hash which its results
/// name, if they name one.
/// @throws RunFileError that names what was changed, with the angle
void require_as_stored(const std::filesystem::path& run);

/// Statements that the checks of verify_run() attest if all are good, and statements that they cannot attest.
std::string attested_by(const std::filesystem::path& run);

}  // namespace abcal
