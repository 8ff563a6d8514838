#pragma once

#include <algorithm>
#include <chrono>

#include "app/system/real_clock.h"
#include "drivers/instrument/clock.h"
#include "sim/sim_clock.h"

namespace abcal::console {

/// Simulated time that can be watched: it jumps as SimClock does, but each jump is made when it is due, with
/// simulated time passing `pace` times as fast as real time. Simulated instruments see the same times at any
/// pace, so that a run gives the same readings bit for bit.
class PacedClock final : public Clock {
 public:
  PacedClock(double pace, UtcTime utc_start) : pace_(pace), sim_(utc_start) {}

  Instant now() const override { return sim_.now(); }
  UtcTime utc_now() const override { return sim_.utc_now(); }
  void sleep_until(Instant instant) override {
    if (instant <= sim_.now()) return;
    // Only 100 ms of lag are made up for, as short sleeps last longer than requested.
    constexpr Duration kMadeUp = std::chrono::milliseconds(100);
    due_ = std::max(due_, real_.now() - kMadeUp) + from_seconds(to_seconds(instant - sim_.now()) / pace_);
    real_.sleep_until(due_);
    sim_.sleep_until(instant);
  }

 private:
  double pace_;
  RealClock real_;
  sim::SimClock sim_;
  Instant due_{};
};

}  // namespace abcal::console
