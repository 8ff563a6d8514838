#pragma once

#include <filesystem>
#include <optional>
#include <string>

namespace abcal {

/// A time stamp that is kept with a run.
struct KeptTimeStamp {
  std::string utc, authority;
  bool new_one = true;  ///< False: the run had one already, which stays.
};

/// The address of the authority that stamps runs: as given, otherwise from the environment variable
/// ABCAL_TIME_STAMP_AUTHORITY; empty: none is configured.
std::string time_stamp_authority(const std::string& given);

/// Asks an authority to stamp the hash of a closed run (RFC 3161 over HTTP) and keeps the answer with the
/// run. Waits 15 s at most for the network.
/// @param address  http://HOST[:PORT][/PATH]
/// @throws std::invalid_argument (address, a run that is not closed), std::runtime_error (no stamp)
KeptTimeStamp stamp_run(const std::filesystem::path& run, const std::string& address);

/// Keeps the time stamp of an authority's answer to a request with the run.
/// @throws std::runtime_error if the answer has none
KeptTimeStamp keep_time_stamp_answer(const std::filesystem::path& run, const std::string& request,
                                     const std::string& answer);

/// Like stamp_run() by the configured authority, if the run has no time stamp yet.
/// @return the reason why it still has none, with the remedy; absent: it has one, or no authority is
/// configured
std::optional<std::string> stamp_if_configured(const std::filesystem::path& run);

}  // namespace abcal
