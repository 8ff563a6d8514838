#include "drivers/wire/haltable_line.h"

#include <algorithm>
#include <utility>

namespace abcal::wire {
namespace {

/// Calls a function when it goes out of scope.
template <class Function>
class AtEnd {
 public:
  explicit AtEnd(Function function) : function_(std::move(function)) {}
  ~AtEnd() { function_(); }
  AtEnd(const AtEnd&) = delete;
  AtEnd& operator=(const AtEnd&) = delete;

 private:
  Function function_;
};

}  // namespace

void HaltableLine::send(std::string_view bytes) {
  const std::lock_guard lock(send_mutex_);
  if (halts_under_way_ > 0 && !halt_deadline_)
    throw failure(Fault::kNotReady, "the stage is being halted; nothing else is sent until this is done");
  looked_after_.reset();
  stream_->write(bytes);
}

void HaltableLine::discard_input() {
  stream_->discard_input();
  received_.clear();
}

Clock::Instant HaltableLine::deadline_after(Clock::Duration patience) const {
  const Clock::Instant deadline = clock_.now() + patience;
  return halt_deadline_ ? std::min(deadline, *halt_deadline_) : deadline;
}

std::optional<std::string> HaltableLine::take_frame(Clock::Instant deadline) {
  for (;;) {
    const FrameVerdict verdict = check_frame_(received_);
    if (verdict.check == FrameCheck::kInvalid) return std::exchange(received_, {});
    if (verdict.check == FrameCheck::kComplete) {
      std::string frame = received_.substr(0, verdict.length);
      received_.erase(0, verdict.length);
      return frame;
    }
    if (looked_after_ == deadline) return std::nullopt;
    const bool last_look = clock_.now() >= deadline;  // A stream that never pauses must not hold us.
    if (last_look) looked_after_ = deadline;
    const ReceivedBytes more = stream_->read_until(deadline);
    received_ += more.bytes;
    if (more.bytes.empty()) return std::nullopt;
  }
}

bool HaltableLine::halting() const {
  const std::lock_guard lock(send_mutex_);
  return halts_under_way_ > 0;
}

std::uint64_t HaltableLine::halts() const {
  const std::lock_guard lock(send_mutex_);
  return halts_;
}

bool HaltableLine::halt(const std::function<void()>& forget_motion,
                        const std::function<bool()>& has_stopped) noexcept {
  try {
    const Clock::Instant deadline = clock_.now() + halting_.deadline;
    {
      const std::lock_guard lock(send_mutex_);  // Held by others during one write only.
      ++halts_under_way_;                       // From here on the owner sends nothing.
      ++halts_;
    }
    const AtEnd under_way([this] {
      const std::lock_guard lock(send_mutex_);
      --halts_under_way_;
    });
    bool lost = false;
    try {
      send_stop();
    } catch (const InstrumentError& error) {
      lost = error.fault() == Fault::kLinkLost;
    }
    if (lost || !exchange_lock_.try_lock_for(halting_.exchange_patience)) return false;
    const std::lock_guard exchange_lock(exchange_lock_, std::adopt_lock);
    halt_deadline_ = deadline;
    const AtEnd in_halt([this] { halt_deadline_.reset(); });
    forget_motion();
    return stop_and_ask(deadline, has_stopped);
  } catch (...) {  // A mutex failed, or memory is short: not acknowledged.
    return false;
  }
}

void HaltableLine::send_stop() {
  const std::lock_guard lock(send_mutex_);
  stream_->write(halting_.stop);
}

bool HaltableLine::stop_and_ask(Clock::Instant deadline, const std::function<bool()>& has_stopped) {
  while (clock_.now() < deadline) {
    try {
      send_stop();
      if (has_stopped()) return true;
    } catch (const InstrumentError& error) {
      if (error.fault() == Fault::kLinkLost) return false;
    }
    clock_.sleep_until(std::min(clock_.now() + halting_.retry_interval, deadline));
  }
  return false;
}

}  // namespace abcal::wire
