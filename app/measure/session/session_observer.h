#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "app/measure/session/session_events.h"
#include "protocol/run/run_observer.h"

namespace abcal {

/// Makes the events of a session from the notifications of a run.
class SessionObserver final : public RunObserver {
 public:
  /// @param hold_wanted  Asked between two angles; may store notes meanwhile. Empty: never held.
  explicit SessionObserver(SessionListener listener, std::function<bool()> hold_wanted = {})
      : listener_(std::move(listener)), hold_wanted_(std::move(hold_wanted)) {}

  void phase(std::size_t position, RunPhase phase) override;
  void dwells(std::size_t position, std::span<const ItemDwell> dwells) override;
  void notice(std::string_view kind, const Message& text, std::optional<int> item) override;
  bool hold_wanted() override { return hold_wanted_ && hold_wanted_(); }

 private:
  void notify(const SessionEvent& event) const {
    if (listener_) listener_(event);
  }

  SessionListener listener_;
  std::function<bool()> hold_wanted_;
  bool held_ = false;
};

}  // namespace abcal
