#pragma once

#include <algorithm>
#include <condition_variable>
#include <cstddef>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::wire {

/// The bounded queue between the thread that owns a port and the thread that reads. Used inside this folder
/// only.
class ReceiveQueue {
 public:
  ReceiveQueue(std::string name, std::size_t capacity) : name_(std::move(name)), capacity_(capacity) {}

  /// Adds the bytes that fit; the rest is counted as dropped. The kept bytes are then contiguous, with one
  /// gap at their end.
  void push(std::string_view bytes, Clock::Instant arrival) {
    {
      const std::lock_guard lock(mutex_);
      const std::size_t kept = std::min(bytes.size(), capacity_ - waiting_.bytes.size());
      waiting_.append(bytes.substr(0, kept), arrival);
      dropped_ += bytes.size() - kept;
    }
    changed_.notify_all();
  }

  /// The port has vanished: waiting bytes can still be popped, then every call throws kLinkLost with
  /// `reason`.
  void close(std::string reason) {
    {
      const std::lock_guard lock(mutex_);
      if (closed_) return;
      closed_ = true;
      reason_ = std::move(reason);
    }
    changed_.notify_all();
  }

  /// Waits in real time, on steady_clock.
  ReceivedBytes pop_until(Clock::Instant deadline) {
    std::unique_lock lock(mutex_);
    changed_.wait_until(lock, deadline, [this] { return !waiting_.bytes.empty() || closed_; });
    if (waiting_.bytes.empty()) throw_if_closed_locked();
    return std::exchange(waiting_, {});
  }

  void discard() {
    const std::lock_guard lock(mutex_);
    waiting_ = {};
    throw_if_closed_locked();
  }

  bool closed() const {
    const std::lock_guard lock(mutex_);
    return closed_;
  }

  void throw_if_closed() const {
    const std::lock_guard lock(mutex_);
    throw_if_closed_locked();
  }

  std::size_t dropped() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
  }

  const std::string& name() const { return name_; }

 private:
  void throw_if_closed_locked() const {
    if (closed_) throw InstrumentError(name_, Fault::kLinkLost, reason_);
  }

  const std::string name_;
  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  ReceivedBytes waiting_;
  std::size_t dropped_ = 0;
  bool closed_ = false;
  std::string reason_;
};

}  // namespace abcal::wire
