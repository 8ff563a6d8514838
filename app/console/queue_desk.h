#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>

#include "app/console/asker.h"
#include "app/console/event.h"
#include "app/console/queue.h"
#include "app/console/request.h"
#include "app/console/session.h"

namespace abcal::console {

/// Brings queue and bench together: carries out what pages ask for, and follows the events of the bench. What
/// moves between two items is begun by a person; a further run of the item that stays mounted is not asked
/// for again, unless the queue is paused. For one thread.
class QueueDesk {
 public:
  QueueDesk(std::filesystem::path file, Session& session, std::function<void(Event)> tell);

  Session::Refusal carry_out(const Asker& by, const QueueCommand& command);
  void see(const Event& event);

 private:
  Session::Refusal check(std::int64_t entry);
  Session::Refusal start(std::int64_t entry, const Asker& by);
  void see_activity(const ActivitySeen& seen);
  void tell() { tell_(QueueSeen{queue_.json()}); }

  Queue queue_;
  Session& session_;
  std::function<void(Event)> tell_;
  Asker starter_;              ///< Who started the entry that is measured.
  std::int64_t starting_ = 0;  ///< The entry whose run has no file yet.
  bool own_ = false;           ///< What the bench does now was begun here.
};

}  // namespace abcal::console
