#pragma once

#include <algorithm>
#include <chrono>
#include <stop_token>

#include "drivers/instrument/clock.h"
#include "protocol/run/run_observer.h"

namespace abcal {

/// A clock whose waits a stop request ends: every wait tests a stop token at least once in kSlice.
class StoppableClock {
 public:
  /// Longest sleep or wait for bytes between two tests of the stop token.
  static constexpr Clock::Duration kSlice = std::chrono::milliseconds(20);

  /// Both must outlive this.
  StoppableClock(Clock& clock, const std::stop_token& stop) : clock_(clock), stop_(stop) {}

  Clock::Instant now() const { return clock_.now(); }
  Clock::UtcTime utc_now() const { return clock_.utc_now(); }
  bool stop_requested() const { return stop_.stop_requested(); }

  /// @throws RunInterrupted if a stop is requested.
  void throw_if_stopped() const {
    if (stop_.stop_requested()) throw RunInterrupted(Message("stopped by the operator"));
  }

  /// @throws RunInterrupted
  void wait_until(Clock::Instant instant) const {
    for (Clock::Instant now = clock_.now(); now < instant; now = clock_.now()) {
      throw_if_stopped();
      clock_.sleep_until(std::min(instant, now + kSlice));
    }
    throw_if_stopped();
  }

 private:
  Clock& clock_;
  const std::stop_token& stop_;
};

}  // namespace abcal
