#pragma once

#include <chrono>
#include <cstdint>

namespace abcal {

/// The only source of time. Instruments, protocol and simulation are handed a Clock and never ask the system:
/// a dry run then jumps from event to event, and repeats bit for bit.
class Clock {
 public:
  using Duration = std::chrono::nanoseconds;
  /// Monotonic time; its zero has no meaning.
  using Instant = std::chrono::time_point<std::chrono::steady_clock, Duration>;
  /// Coordinated universal time, for records that people read.
  using UtcTime = std::chrono::time_point<std::chrono::system_clock, Duration>;

  virtual ~Clock() = default;
  virtual Instant now() const = 0;
  virtual UtcTime utc_now() const = 0;
  /// Returns at or after `instant`; at once if it has passed.
  virtual void sleep_until(Instant instant) = 0;
};

/// A duration of `seconds`, rounded to the nanosecond.
inline Clock::Duration from_seconds(double seconds) {
  return std::chrono::round<Clock::Duration>(std::chrono::duration<double>(seconds));
}

inline double to_seconds(Clock::Duration duration) {
  return std::chrono::duration<double>(duration).count();
}

}  // namespace abcal
