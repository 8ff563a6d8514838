#pragma once

#include <thread>

#include "drivers/instrument/clock.h"

namespace abcal::test {

/// Real time, for tests over real file descriptors.
class SteadyClock final : public Clock {
 public:
  Instant now() const override { return std::chrono::steady_clock::now(); }
  UtcTime utc_now() const override { return std::chrono::system_clock::now(); }
  void sleep_until(Instant instant) override { std::this_thread::sleep_until(instant); }
};

}  // namespace abcal::test
