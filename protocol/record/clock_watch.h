#pragma once

#include <optional>

#include "drivers/instrument/clock.h"
#include "drivers/text/message.h"

namespace abcal {

/// The readings of two clocks, which should advance equally, at one moment.
struct ClockPair {
  Clock::UtcTime utc;         ///< By the system clock.
  Clock::Duration monotonic;  ///< Since some fixed moment.
};

/// The step of the system clock between two moments, if it is more than a clock that is only corrected in its
/// rate can gain: 1 s and 500 parts in a million of the time between (the largest rate that a time service
/// sets).
std::optional<Clock::Duration> clock_step(const ClockPair& before, const ClockPair& now);

/// The words for a step, for the event log.
Message describe_clock_step(Clock::Duration step);

/// Finds the steps of the system clock while a run lasts.
class ClockWatch {
 public:
  explicit ClockWatch(const ClockPair& begin) : before_(begin) {}

  /// Compares the clocks with those of the call before.
  /// @return the words for the event log if the system clock was moved in between
  std::optional<Message> find_step(const ClockPair& now);

 private:
  ClockPair before_;
};

}  // namespace abcal
