#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "app/witness/witness_line.h"

namespace abcal {

/// The witness did not answer in time, or its socket is not served. The request may be repeated: a witness
/// answers a repetition with the line that it has signed already.
class WitnessSilent : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The answer to a link of WitnessClient::post_link().
struct LinkAnswer {
  std::int64_t k = 0;
  std::optional<WitnessedLine> line;  ///< Absent: refused.
  std::string refusal;                ///< The reason; empty: not refused.
};

/// Asks a witness (abcal-witness, docs/witness.md) over its socket. Every line that it returns is checked: it
/// agrees with the question, and its signature fits public_pem(). Any thread may use it.
class WitnessClient {
 public:
  struct Limits {
    std::chrono::milliseconds answer{2000};   ///< Longest time of a question.
    std::chrono::milliseconds start{10'000};  ///< Instead, if this program must start a witness first.
    std::chrono::milliseconds again{1000};    ///< Between an attempt to post a link and the next one.
  };

  /// The witness of this computer: the socket that the environment variable ABCAL_WITNESS names ("none": no
  /// witness); otherwise kWitnessSocket if it exists; otherwise, if ABCAL_SIGNING_KEY names a key, a witness
  /// that this program starts and that ends with it, with the log witness-KEY.db in state_folder(), where KEY
  /// is the beginning of the fingerprint of its key.
  /// @return null if there is none
  /// @throws std::runtime_error if that witness cannot be reached or cannot start; std::invalid_argument if
  /// the key cannot be used
  static std::unique_ptr<WitnessClient> find();
  /// Whether ABCAL_WITNESS=none asks for no witness.
  static bool is_declined();

  /// A witness that serves a socket.
  /// @throws WitnessSilent, WitnessRefusal
  WitnessClient(std::filesystem::path socket, Limits limits);

  /// A witness that this object starts, and that ends with it.
  /// @param key  file of its private key
  /// @throws WitnessSilent, WitnessRefusal (the key or the log cannot be used), ProgramMissing
  WitnessClient(std::filesystem::path key, std::filesystem::path log, Limits limits);

  /// Links without an answer are dropped; waits for at most one question in progress.
  ~WitnessClient();
  WitnessClient(const WitnessClient&) = delete;
  WitnessClient& operator=(const WitnessClient&) = delete;

  /// The public key of the witness (PEM), as it was when this object was made.
  const std::string& public_pem() const { return public_pem_; }

  /// Whether the witness was started by this program, with a key of this user.
  bool is_beside() const { return !key_.empty(); }

  /// @param head  first link of the run's dwells (head_link())
  /// @throws WitnessSilent, WitnessRefusal
  WitnessedLine begin(const std::string& run, const std::string& bench, const std::string& person,
                      const std::string& head, bool simulated);

  /// @param dwells  number of dwells
  /// @param now  last link of the dwells; the head if there is none
  /// @param events  last link of the events
  /// @throws WitnessSilent, WitnessRefusal
  WitnessedLine close(const std::string& run, std::int64_t dwells, const std::string& now,
                      const std::string& events);

  /// The last entry of a register's audit trail.
  /// @throws WitnessSilent, WitnessRefusal (the witness has signed a later or another one)
  WitnessedLine head(const std::string& register_identity, std::int64_t entries, const std::string& head);

  /// A line that the witness has signed already; absent: it has signed none.
  /// @param k  number of the dwell; 0 for kBegin and kClose. Of a register's heads: the number of entries
  /// @throws WitnessSilent, WitnessRefusal
  std::optional<WitnessedLine> fetch(const std::string& run, WitnessAct act, std::int64_t k = 0);

  /// The head with the most entries that the witness has signed for a register.
  /// @throws WitnessSilent, WitnessRefusal
  std::optional<WitnessedLine> fetch_latest_head(const std::string& register_identity);

  /// Asks for the signature of a link in the background. Links are asked in the order of their posting; one
  /// that stays without an answer is asked again, after a new connection, before the next. Never waits.
  void post_link(const std::string& run, std::int64_t k, const std::string& previous, const std::string& now);

  /// The answers to posted links since the last call, in the order of posting.
  std::vector<LinkAnswer> take_answers();

  /// Waits until every posted link has its answer. @return false: not within that time
  bool wait_until_answered(std::chrono::milliseconds longest);

 private:
  class Connection;
  struct Answer;
  using Instant = std::chrono::steady_clock::time_point;

  WitnessClient(std::filesystem::path socket, std::filesystem::path key, std::filesystem::path log,
                Limits limits);
  Answer ask(const std::string& question);
  std::unique_ptr<Connection> connect() const;
  WitnessedLine sign(const WitnessRequest& request);
  std::optional<WitnessedLine> fetch_stored(const std::string& run, WitnessAct act,
                                            std::optional<std::int64_t> k);
  std::optional<WitnessedLine> line_of(const Answer& answer, const std::string& question) const;
  void work(const std::stop_token& stop);

  const std::filesystem::path socket_, key_, log_;
  const Limits limits_;
  std::string public_pem_;

  std::mutex mutex_;  ///< Guards what follows; never held while waiting for the witness.
  std::condition_variable_any changed_;
  bool is_asking_ = false;  ///< A thread uses `connection_`: one question at a time.
  std::unique_ptr<Connection> connection_;
  std::deque<WitnessRequest> posted_;
  std::vector<LinkAnswer> answers_;
  std::jthread worker_;  ///< Last: it ends before the members that it uses.
};

/// Where the service of this computer listens.
inline constexpr const char* kWitnessSocket = "/run/abcal-witness/socket";

}  // namespace abcal
