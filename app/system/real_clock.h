#pragma once

#include <thread>

#include "drivers/instrument/clock.h"

namespace abcal {

/// The clock on the wall.
class RealClock final : public Clock {
 public:
  Instant now() const override {
    return std::chrono::time_point_cast<Duration>(std::chrono::steady_clock::now());
  }
  UtcTime utc_now() const override {
    return std::chrono::time_point_cast<Duration>(std::chrono::system_clock::now());
  }
  void sleep_until(Instant instant) override { std::this_thread::sleep_until(instant); }
};

}  // namespace abcal
