#pragma once

#include <chrono>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/session/session_events.h"
#include "app/system/detached_process.h"

namespace abcal {

/// The message of an event for the recipients in [notify]: schema abcal.message/1 without time and bench;
/// nothing for events without a message. Messages report a lost port and its return, halts by the watchdog,
/// and the end.
std::optional<nlohmann::json> message_of(const SessionEvent& event);

/// Sends messages on a run to the recipients in [notify]. Each is sent by a separate program
/// (abcal-transfer), which may outlive this one, so that measuring never waits for a network.
class Notifier {
 public:
  explicit Notifier(NotifyConfig config) : config_(std::move(config)) {}
  Notifier(const Notifier&) = delete;
  Notifier& operator=(const Notifier&) = delete;
  ~Notifier();

  /// Begins to send the message of an event, if it has one. Does not throw: see failures().
  void send(const SessionEvent& event, const std::string& utc);

  /// Failures of the messages whose sending ended since the last call.
  /// @param longest  time to wait for messages in transit, which are then reported as not confirmed
  std::vector<std::string> failures(std::chrono::milliseconds longest = std::chrono::milliseconds(0));

 private:
  void start(const nlohmann::json& message);

  NotifyConfig config_;
  std::string bench_, item_, operator_, file_;
  bool simulated_ = false;
  std::vector<ConnectedProcess> sendings_;
  std::vector<std::string> failures_;
};

}  // namespace abcal
