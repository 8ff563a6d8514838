#pragma once

#include <condition_variable>
#include <mutex>

#include "drivers/instrument/clock.h"

namespace abcal::wire {

/// A mutex that can be waited for until a deadline: held by a driver from a query to its reply, while halt()
/// must not wait without limit. (std::timed_mutex could too, but the thread sanitizer of GCC 12 does not see
/// its lock and reports every use.)
class TimedLock {
 public:
  void lock() {
    std::unique_lock lock(mutex_);
    free_.wait(lock, [this] { return !held_; });
    held_ = true;
  }
  bool try_lock_for(Clock::Duration patience) {
    std::unique_lock lock(mutex_);
    if (!free_.wait_for(lock, patience, [this] { return !held_; })) return false;
    held_ = true;
    return true;
  }
  void unlock() {
    {
      const std::lock_guard lock(mutex_);
      held_ = false;
    }
    free_.notify_one();
  }

 private:
  std::mutex mutex_;
  std::condition_variable free_;
  bool held_ = false;
};

}  // namespace abcal::wire
