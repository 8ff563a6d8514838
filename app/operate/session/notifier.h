#pragma once

#include <chrono>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/ground/bench_file/bench_config.h"
#include "app/ground/system/detached_process.h"
#include "app/operate/session/session_events.h"

namespace abcal {

/// What those in [notify] are told of an event: schema abcal.message/1 without time and bench; nothing for
/// events that are not for them. They hear of a lost port and its return, of halts by the watchdog, and of
/// the end.
std::optional<nlohmann::json> message_of(const SessionEvent& event);

/// Tells those in [notify] how a run goes. Each message is sent by a program of its own (abcal-transfer),
/// which outlives this one: a run never waits for a network.
class Notifier {
 public:
  explicit Notifier(NotifyConfig config) : config_(std::move(config)) {}
  Notifier(const Notifier&) = delete;
  Notifier& operator=(const Notifier&) = delete;
  ~Notifier();

  /// Begins to send the message of an event, if it has one. Does not throw: see failures().
  void send(const SessionEvent& event, const std::string& utc);

  /// Why messages did not arrive, of those whose sending is over since the last call.
  /// @param longest  waits so long for those that are still being sent; then says that they are not confirmed
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
