#pragma once

#include <atomic>
#include <chrono>

#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// A clock that jumps: sleeping costs nothing, so an hour's measurement is dry-run in seconds, and every run
/// sees the same times bit for bit. Time passes only inside sleep_until(). Any thread may
/// sleep; it never goes back.
class SimClock final : public Clock {
 public:
  static constexpr UtcTime kDefaultStart = std::chrono::sys_days{std::chrono::January / 1 / 2000};

  /// `utc_start` is utc_now() at the instant zero, at which the clock starts.
  explicit SimClock(UtcTime utc_start = kDefaultStart) : utc_start_(utc_start) {}

  Instant now() const override { return Instant(Duration(since_start_ns_.load())); }
  UtcTime utc_now() const override { return utc_start_ + Duration(since_start_ns_.load()); }
  void sleep_until(Instant instant) override {
    const Duration::rep target = instant.time_since_epoch().count();
    Duration::rep seen = since_start_ns_.load();
    while (seen < target && !since_start_ns_.compare_exchange_weak(seen, target)) {
    }
  }

 private:
  UtcTime utc_start_;
  std::atomic<Duration::rep> since_start_ns_{0};
};

}  // namespace abcal::sim
