#pragma once

#include <atomic>
#include <cstdint>

#include "drivers/instrument/clock.h"

namespace abcal::test {

/// A Clock that stands still until a caller sleeps or sets it. For any thread.
class FakeClock final : public Clock {
 public:
  Instant now() const override { return Instant(Duration(nanoseconds_.load())); }
  UtcTime utc_now() const override { return UtcTime(Duration(nanoseconds_.load())); }
  void sleep_until(Instant instant) override {
    const std::int64_t wanted = instant.time_since_epoch().count();
    std::int64_t seen = nanoseconds_.load();
    while (seen < wanted && !nanoseconds_.compare_exchange_weak(seen, wanted)) {
    }
  }
  void advance(Duration duration) { sleep_until(now() + duration); }

 private:
  std::atomic<std::int64_t> nanoseconds_{1'000'000'000};
};

}  // namespace abcal::test
