#include "app/console/queue_desk.h"

#include <fmt/format.h>

#include <utility>

namespace abcal::console {

QueueDesk::QueueDesk(std::filesystem::path file, Session& session, std::function<void(Event)> notify)
    : queue_(std::move(file)), session_(session), notify_(std::move(notify)) {
  this->notify();
}

Session::Refusal QueueDesk::carry_out(const Asker& by, const QueueCommand& command) {
  struct Do {
    QueueDesk& desk;
    const Asker& by;
    Session::Refusal operator()(const QueueAdd& add) const { return desk.queue_.add(add.choice, add.runs); }
    Session::Refusal operator()(const QueueMove& move) const { return desk.queue_.move(move.entry, move.by); }
    Session::Refusal operator()(const QueueRemove& remove) const { return desk.queue_.remove(remove.entry); }
    Session::Refusal operator()(const QueueRepeat& repeat) const { return desk.queue_.repeat(repeat.entry); }
    Session::Refusal operator()(const QueuePause& pause) const { return desk.queue_.pause(pause.paused); }
    Session::Refusal operator()(const QueueMounted& mounted) const { return desk.check(mounted.entry); }
    Session::Refusal operator()(const QueueStart& start) const { return desk.start(start.entry, by); }
  };
  Session::Refusal refusal = std::visit(Do{*this, by}, command);
  if (!refusal) notify();
  return refusal;
}

Session::Refusal QueueDesk::check(std::int64_t entry) {
  if (Session::Refusal refusal = queue_.may_check(entry)) return refusal;
  queue_.unchecked();
  Session::Refusal refusal = session_.check_item(entry, queue_.next()->choice, queue_.before());
  own_ = own_ || !refusal;
  return refusal;
}

Session::Refusal QueueDesk::start(std::int64_t entry, const Asker& by) {
  if (Session::Refusal refusal = queue_.may_start(entry)) return refusal;
  if (Session::Refusal refusal = session_.start(queue_.next()->choice, by)) return refusal;
  own_ = true;
  starting_ = entry;
  starter_ = by;
  return std::nullopt;
}

void QueueDesk::see(const Event& event) {
  if (const auto* activity = std::get_if<ActivitySeen>(&event)) return see_activity(*activity);
  if (const auto* checked = std::get_if<ItemChecked>(&event)) {
    queue_.checked(checked->entry, checked->check);
    notify();
  }
  const auto* of_session = std::get_if<SessionEvent>(&event);
  if (of_session == nullptr) return;
  if (const auto* began = std::get_if<RunBeganEvent>(of_session); began != nullptr && starting_ != 0) {
    queue_.began(std::exchange(starting_, 0), began->file);
    notify();
  }
  if (const auto* end = std::get_if<FinishedEvent>(of_session))
    if (queue_.ended(end->file, end->complete, end->reason)) notify();
}

void QueueDesk::see_activity(const ActivitySeen& seen) {
  if (seen.activity != Activity::kIdle) {
    if (own_) return;
    queue_.unchecked();  // During another activity the mounted item may have been changed.
    return notify();
  }
  if (!session_.is_idle()) return;  // Something else has begun since.
  own_ = false;
  if (const std::int64_t failed = std::exchange(starting_, 0); failed != 0) {
    queue_.did_not_begin(failed);
    return notify();
  }
  const QueueEntry* const again = queue_.repeats();
  if (again == nullptr) return;
  const std::int64_t number = again->number;
  notify_(LogLine{LogLine::Grade::kInfo,
                  Message("Run {n} of {all} of {item} begins: the item stays mounted.",
                          again->made.size() + 1, again->wanted, again->choice.item->serial_number)});
  if (const Session::Refusal refusal = session_.start(again->choice, starter_)) {
    notify_(LogLine{LogLine::Grade::kProblem, *refusal});
    queue_.did_not_begin(number);
    return notify();
  }
  own_ = true;
  starting_ = number;
}

}  // namespace abcal::console
