#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace abcal {

/// Signature of the hash of a closed run (of version 1.0; later ones have a witness), and the time stamp of
/// an authority. Empty: not signed, not stamped.
struct RunSeal {
  std::string signer;      ///< Name of the bench, and its public key (PEM) from the next line on.
  std::string signature;   ///< Ed25519, of statement_of_run().
  std::string time_stamp;  ///< RFC 3161, of the SHA-256.

  std::string signer_name() const { return signer.substr(0, signer.find('\n')); }
  std::string public_pem() const {
    const std::size_t end = signer.find('\n');
    return end == std::string::npos ? std::string() : signer.substr(end + 1);
  }
};

// All work on `RUN.results`, which must exist, and throw RunFileError.

/// Signature and time stamp of a run; empty if there are none, or no results.
RunSeal read_seal(const std::filesystem::path& run_path);

/// Keeps a time stamp of the run's hash. One that is there stays: it is the earlier one.
/// @return false: there was one
bool keep_time_stamp(const std::filesystem::path& run_path, const std::string& token);

/// A stored analysis.
struct StoredAnalysis {
  std::string utc, program_version, estimator, result_json;
};

/// The analyses stored for a run, oldest first; none where there are no results.
std::vector<StoredAnalysis> stored_analyses(const std::filesystem::path& run_path);

/// The last one of an estimator, if there is any.
std::optional<StoredAnalysis> last_analysis(const std::filesystem::path& run_path,
                                            const std::string& estimator);

}  // namespace abcal
