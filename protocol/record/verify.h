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
/// the results name; the event log, the analyses and the certificates by their hash chains. A run that is not
/// closed has no hash yet, which is said and is not good.
/// @throws RunFileError if the file is no run file at all.
std::vector<IntegrityCheck> verify_run(const std::filesystem::path& run);

}  // namespace abcal
