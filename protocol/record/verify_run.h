#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"

namespace abcal {

/// One check and its outcome.
struct IntegrityCheck {
  std::string what;
  bool good = false;
  std::string found;  ///< In words.
  int item = 0;       ///< With several items: the item concerned, from 1; 0: the run.
};

/// A run and the checks of its measurements, from one reading of its file.
struct CheckedRun {
  std::filesystem::path path;
  std::vector<StoredRun> items;  ///< As RunFile::load_items(), or the one that was asked for.
  /// Checks that a run passes in any state: its chains, and that its means, spreads, standard uncertainties
  /// and flags follow from its readings.
  std::vector<IntegrityCheck> measurements;
  std::optional<std::string> sha256;   ///< The hash of the file; absent: its results name none.
  std::optional<IntegrityCheck> hash;  ///< A complete run against its results; absent: they name none.

  bool complete() const { return items.front().state == RunState::kComplete; }
};

/// Reads a run and checks its measurements, without a judgement.
/// @param item  from 1; 0: all
/// @throws RunFileError if the file is not a run file
CheckedRun read_and_check(const std::filesystem::path& run, int item = 0);

/// Whether a closed run and its results are consistent with each other: every byte of the run by its SHA-256,
/// which the results name; the event log, the dwells with their readings, the analyses and the certificates
/// by their hash chains; means, spreads, standard uncertainties and flags by computing them again from the
/// readings. A run that is not closed has no hash yet: that check is not good. Files of version 2
/// chain no dwells.
/// @throws RunFileError if the file is not a run file.
std::vector<IntegrityCheck> verify_run(const std::filesystem::path& run);
/// The same findings about a run that read_and_check() has read: only its results are read in addition.
std::vector<IntegrityCheck> verify_run(const CheckedRun& run);

/// Checks a run that is to be continued or closed: its chains, and that its means, spreads, standard
/// uncertainties and flags follow from its readings.
/// @throws RunFileError that names what was changed, with the angle
void require_unchanged(const std::filesystem::path& run);

/// Reads a complete run whose bytes have the SHA-256 that its results name, all as they were when it was
/// closed; the measurements are not checked again. nullopt: any other run.
/// @throws RunFileError if the file is not a run file
std::optional<CheckedRun> read_if_as_closed(const std::filesystem::path& run);

/// Reads a run that is to give a result. Requires the same, and that its bytes have the hash which its
/// results name, if they name one.
/// @param item  as of read_and_check()
/// @throws RunFileError that names what was changed, with the angle
CheckedRun read_as_stored(const std::filesystem::path& run, int item = 0);

/// Whether each analysis in the results of a run is linked to the one before it.
/// @throws RunFileError if there are no results
bool analyses_are_linked(const std::filesystem::path& run);

/// Statements that the checks of verify_run() attest if all are good, and statements that they cannot attest.
std::string attested_by(const std::filesystem::path& run);

}  // namespace abcal
