#include "drivers/wire/replay_stream.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace abcal::wire {
namespace {

using Kind = WireEvent::Kind;

std::string in_quotes(std::string_view bytes) {
  constexpr std::size_t kShown = 80;
  return fmt::format("{:?}{}", bytes.substr(0, kShown),
                     bytes.size() > kShown ? fmt::format(" and {} bytes more", bytes.size() - kShown) : "");
}

double seconds_at(Clock::Instant time) {
  return to_seconds(time.time_since_epoch());
}

}  // namespace

ReplayStream::ReplayStream(std::vector<WireEvent> events, Clock& clock, std::function<void()> on_end)
    : events_(std::move(events)), clock_(clock), on_end_(std::move(on_end)) {
  if (!events_.empty() && events_.front().kind == Kind::kOpened) {
    name_ = events_.front().bytes;
    ++cursor_;
  }
}

/// The next event that is an outcome of a call; null behind the last.
const WireEvent* ReplayStream::next() const {
  for (; cursor_ < events_.size() && events_[cursor_].kind == Kind::kDropped; ++cursor_) {
    dropped_ = std::stoull(events_[cursor_].bytes);
  }
  return cursor_ < events_.size() ? &events_[cursor_] : nullptr;
}

void ReplayStream::fail_as_recorded() {
  const WireEvent& event = events_[cursor_++];
  clock_.sleep_until(event.time);
  throw parse_failure(event.bytes).error;
}

void ReplayStream::end() const {
  if (on_end_) on_end_();
  throw InstrumentError(name_, Fault::kLinkLost,
                        events_.empty() ? "the recording ends here: it contains nothing of this stream"
                                        : fmt::format("the recording ends here, at t = {:.6f} s",
                                                      seconds_at(events_.back().time)));
}

void ReplayStream::leave(std::string_view found, const WireEvent& recorded) const {
  throw InstrumentError(name_, Fault::kLinkLost,
                        fmt::format("the replay leaves the recording: found {}, recorded {} at t = {:.6f} s; "
                                    "replay with the version of abcal that recorded it",
                                    in_quotes(found), in_quotes(recorded.bytes), seconds_at(recorded.time)));
}

void ReplayStream::write(std::string_view bytes) {
  const std::lock_guard lock(mutex_);
  const WireEvent* event = next();
  for (; event != nullptr && event->kind != Kind::kWritten; event = next()) {
    if (event->kind == Kind::kFailed) fail_as_recorded();
    if (event->kind == Kind::kReceived) waiting_.append(event->bytes, event->arrival);
    ++cursor_;
  }
  if (event == nullptr) end();
  if (event->bytes != bytes) leave(bytes, *event);
  clock_.sleep_until(event->time);
  ++cursor_;
  // next() is not used here: a failed write directly follows the bytes of the write.
  if (cursor_ < events_.size() && events_[cursor_].kind == Kind::kFailed &&
      parse_failure(events_[cursor_].bytes).call == WireCall::kWrite) {
    fail_as_recorded();
  }
}

ReceivedBytes ReplayStream::read_until(Clock::Instant deadline) {
  const std::lock_guard lock(mutex_);
  if (!waiting_.bytes.empty()) return std::exchange(waiting_, {});
  const WireEvent* event = next();
  if (event == nullptr) end();
  switch (event->kind) {
    case Kind::kFailed:
      fail_as_recorded();
    case Kind::kReceived:
    case Kind::kDiscarded:  // The recorded call discarded these bytes; now they are read and then discarded.
      ++cursor_;
      clock_.sleep_until(event->time);
      if (event->bytes.empty()) clock_.sleep_until(deadline);
      return {event->bytes, event->kind == Kind::kReceived ? event->arrival : event->time};
    default:
      clock_.sleep_until(deadline);
      return {{}, clock_.now()};
  }
}

void ReplayStream::discard_input() {
  const std::lock_guard lock(mutex_);
  waiting_ = {};
  const WireEvent* event = next();
  if (event != nullptr && event->kind == Kind::kDiscarded) {
    clock_.sleep_until(event->time);
    ++cursor_;
    event = next();
  }
  if (event != nullptr && event->kind == Kind::kFailed &&
      parse_failure(event->bytes).call == WireCall::kDiscard) {
    fail_as_recorded();
  }
}

std::size_t ReplayStream::dropped_bytes() const {
  const std::lock_guard lock(mutex_);
  next();
  return dropped_;
}

}  // namespace abcal::wire
