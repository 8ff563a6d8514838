#pragma once

#include <cstdint>

#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// The instants at which an instrument samples: tick n is n / rate seconds after the start.
class SampleGrid {
 public:
  SampleGrid(Clock::Instant start, unsigned rate_hz)
      : start_(start), rate_hz_(rate_hz), period_(from_seconds(1.0 / rate_hz)) {}

  Clock::Instant time(std::uint64_t tick) const {
    // Whole seconds apart, so that the grid does not drift.
    const std::uint64_t seconds = tick / rate_hz_;
    const std::uint64_t rest = tick % rate_hz_;
    return start_ + std::chrono::seconds(static_cast<std::int64_t>(seconds)) +
           Clock::Duration(static_cast<std::int64_t>(rest * kNanosecondsPerSecond / rate_hz_));
  }

  std::uint64_t first_after(Clock::Instant t) const {
    if (t < start_) return 0;
    const auto since = static_cast<std::uint64_t>((t - start_).count());
    std::uint64_t tick = since / kNanosecondsPerSecond * rate_hz_ +
                         since % kNanosecondsPerSecond * rate_hz_ / kNanosecondsPerSecond;
    while (time(tick) <= t) ++tick;
    return tick;
  }

  Clock::Duration period() const { return period_; }

 private:
  static constexpr std::uint64_t kNanosecondsPerSecond = 1'000'000'000;
  Clock::Instant start_;
  unsigned rate_hz_;
  Clock::Duration period_;
};

}  // namespace abcal::sim
