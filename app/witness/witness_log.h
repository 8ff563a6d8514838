#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/witness/witness_line.h"
#include "drivers/instrument/clock.h"
#include "protocol/record/sqlite.h"

namespace abcal {

/// The clocks of the computer at a moment.
struct WitnessMoment {
  Clock::UtcTime utc;
  std::string boot_id;         ///< Names the start of the computer; empty: not known.
  Clock::Duration since_boot;  ///< Time in suspension included (CLOCK_BOOTTIME).
};

/// The lines that a witness has signed, in a file of SQLite; each line names the SHA-256 of the one before.
/// Decides which requests contradict it. Several processes may use one log; an object belongs to one thread.
class WitnessLog {
 public:
  /// Opens the log, or makes it if it does not exist.
  /// @param now  the clocks; asked once for each new line, while no other process can add one
  /// @throws std::invalid_argument if the key is not a private Ed25519 key, or is not that of the log
  /// @throws RunFileError
  WitnessLog(const std::filesystem::path& path, std::string private_pem, std::function<WitnessMoment()> now);

  /// The public key (PEM).
  const std::string& public_pem() const { return public_pem_; }

  /// Signs a request, or returns the stored line if it has signed the same one before. The line is on the
  /// disk when this returns.
  /// @param uid  user ID of the process that asks
  /// @throws WitnessRefusal if the request is invalid or contradicts what was signed
  /// @throws RunFileError
  WitnessedLine answer(const WitnessRequest& request, std::uint32_t uid);

  /// A stored line.
  /// @param k  number of the dwell; 0 for kBegin and kClose. Of a register's heads: the number of entries
  std::optional<WitnessedLine> fetch(const std::string& run, WitnessAct act, std::int64_t k);

  /// The stored line of that act with the highest number.
  std::optional<WitnessedLine> fetch_latest(const std::string& run, WitnessAct act);

  /// Reads the whole log: counters, hashes, signatures, clocks, and the columns by which lines are found.
  /// @return findings in words; empty: the log is whole
  std::vector<std::string> verify();

  /// Number of lines.
  std::int64_t size();

 private:
  struct LastLink {
    std::int64_t k = 0;
    std::string link;
  };

  void require_next_link(const WitnessRequest& request);
  void require_last_link(const WitnessRequest& request);
  void require_not_put_back(const WitnessRequest& request);
  WitnessStatement begin_of(const std::string& run);
  LastLink last_link(const WitnessStatement& begin);
  std::optional<WitnessStatement> latest(const std::string& run, WitnessAct act);
  std::int64_t begins_of(const std::string& run);
  WitnessedLine add(const WitnessRequest& request, std::int64_t k, std::uint32_t uid);

  const std::string file_, private_pem_, public_pem_;
  const std::function<WitnessMoment()> now_;
  SqliteDatabase database_;
};

}  // namespace abcal
