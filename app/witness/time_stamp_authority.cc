#include "app/witness/time_stamp_authority.h"

#include <fmt/format.h>

#include <chrono>
#include <cstdlib>
#include <stdexcept>

#include "app/system/helper_program.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/temporary_folder.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "protocol/record/time_stamp.h"

namespace abcal {
namespace {

/// abcal-transfer gives up after 15 s.
constexpr std::chrono::seconds kLongest{20};

/// Sends a request to an authority (RFC 3161, 3.4) and returns its answer.
/// @throws std::invalid_argument (address), ProgramMissing, RunInterrupted, std::runtime_error (no answer)
std::string ask_authority(const std::string& address, const std::string& request) {
  const TemporaryFolder folder;
  const std::filesystem::path query = folder / "query.tsq", answer = folder / "answer.tsr";
  OutputFile(query).write(request);
  run_helper("abcal-transfer", "time stamps need", {"time-stamp", address, query.string(), answer.string()},
             kLongest);
  return read_file(answer);
}

void require_closed(const std::filesystem::path& run) {
  if (!RunFile::is_closed(run))
    throw std::invalid_argument(run.string() + ": is not closed; only a closed run has a hash to be stamped");
}

}  // namespace

std::string time_stamp_authority(const std::string& given) {
  if (!given.empty()) return given;
  const char* configured = std::getenv("ABCAL_TIME_STAMP_AUTHORITY");
  return configured == nullptr ? std::string() : configured;
}

KeptTimeStamp keep_time_stamp_answer(const std::filesystem::path& run, const std::string& request,
                                     const std::string& answer_der) {
  require_closed(run);
  const std::string sha256 = sha256_of_file(run);
  const TimeStampAnswer answer = read_time_stamp_answer(answer_der, request);
  if (answer.token.empty()) throw std::runtime_error("no time stamp: " + answer.refused);
  const TimeStampCheck stamp = check_time_stamp(answer.token, sha256, {});
  return {stamp.utc, stamp.authority, keep_time_stamp(run, answer.token)};
}

KeptTimeStamp stamp_run(const std::filesystem::path& run, const std::string& address) {
  require_closed(run);
  const std::string request = time_stamp_request(sha256_of_file(run));
  return keep_time_stamp_answer(run, request, ask_authority(address, request));
}

std::optional<std::string> stamp_if_configured(const std::filesystem::path& run) {
  const std::string authority = time_stamp_authority({});
  if (authority.empty() || !read_seal(run).time_stamp.empty()) return std::nullopt;
  try {
    (void)stamp_run(run, authority);
    return std::nullopt;
  } catch (const std::exception& error) {
    return fmt::format(
        "{} has no time stamp yet: {}. It is asked for again by `abcal issue`, or by: abcal lab timestamp {}",
        run.string(), error.what(), run.string());
  }
}

}  // namespace abcal
