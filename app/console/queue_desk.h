#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>

#include "app/console/asker.h"
#include "app/console/console_session.h"
#include "app/console/event.h"
#include "app/console/queue.h"
#include "app/console/request.h"

namespace abcal::console {

/// Connects the queue to the bench: carries out requests of pages, and follows the events of the bench. A
/// person starts the first run of each mounted item; further runs of it start by themselves unless the queue
/// is paused. For one thread.
class QueueDesk {
 public:
  QueueDesk(std::filesystem::path file, Session& session, std::function<void(Event)> notify);

  Session::Refusal carry_out(const Asker& by, const QueueCommand& command);
  void see(const Event& event);

 private:
  Session::Refusal check(std::int64_t entry);
  Session::Refusal start(std::int64_t entry, const Asker& by);
  void see_activity(const ActivitySeen& seen);
  void notify() { notify_(StateSeen{"queue", queue_.json()}); }

  Queue queue_;
  Session& session_;
  std::function<void(Event)> notify_;
  Asker starter_;              ///< Who started the current entry.
  std::int64_t starting_ = 0;  ///< The entry whose run has no file yet.
  bool own_ = false;           ///< The current activity was begun here.
};

}  // namespace abcal::console
