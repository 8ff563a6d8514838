#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <list>
#include <optional>
#include <set>
#include <string>

#include "app/system/descriptor.h"
#include "app/witness/witness_log.h"

namespace abcal {

/// Answers the questions of programs from a log (WitnessLog), one after the other. A client that sends
/// anything else receives the reason of the refusal.
class WitnessService {
 public:
  struct Options {
    std::filesystem::path socket;  ///< Where it listens for programs of all users; empty: nowhere.
    /// One end of a socket to the program that has started the service: a client, with whose end the service
    /// ends.
    Descriptor owner;
    /// User IDs for which it signs and fetches; nullopt: for all.
    std::optional<std::set<std::uint32_t>> users = std::nullopt;
  };

  /// Most connections at a time. One more takes the place of that which has been silent the longest.
  static constexpr std::size_t kMostClients = 32;

  /// @throws std::runtime_error if the socket cannot be made, or another process serves it
  WitnessService(WitnessLog& log, Options options);
  ~WitnessService();
  WitnessService(const WitnessService&) = delete;
  WitnessService& operator=(const WitnessService&) = delete;

  /// Serves until the end of the owner; without an owner, without end.
  void serve();

 private:
  struct Client {
    Descriptor socket;
    std::uint32_t uid = 0;
    bool is_owner = false;
  };

  bool tick();
  void accept();
  bool answer(const Client& client);
  std::string reply_to(const std::string& packet, std::uint32_t uid);

  WitnessLog& log_;
  const std::filesystem::path path_;
  const std::optional<std::set<std::uint32_t>> users_;
  Descriptor listener_;
  std::list<Client> clients_;  ///< The one that has been silent the longest first.
};

/// Reports to the owner why the witness cannot start: answers each of its questions with the reason until it
/// ends.
void refuse_owner(int socket, const std::string& why);

}  // namespace abcal
