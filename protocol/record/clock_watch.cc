#include "protocol/record/clock_watch.h"

#include <fmt/format.h>

#include <chrono>

namespace abcal {
namespace {

constexpr Clock::Duration kLeastStep = std::chrono::seconds(1);
/// Adjustments of the rate stay within 500 parts in a million (Linux, adjtimex(2)).
constexpr int kTimePerLargestSlew = 2000;

}  // namespace

std::optional<Clock::Duration> clock_step(const ClockPair& before, const ClockPair& now) {
  const Clock::Duration elapsed = now.monotonic - before.monotonic;
  const Clock::Duration step = (now.utc - before.utc) - elapsed;
  const Clock::Duration limit = kLeastStep + std::chrono::abs(elapsed) / kTimePerLargestSlew;
  if (std::chrono::abs(step) <= limit) return std::nullopt;
  return step;
}

Message describe_clock_step(Clock::Duration step) {
  return Message(
      "the system clock changed by {step:+.3f} s (set by a person or a time service, or the computer was "
      "suspended); the times of the run are not affected, because they follow the monotonic clock",
      to_seconds(step));
}

std::optional<Message> ClockWatch::find_step(const ClockPair& now) {
  const std::optional<Clock::Duration> step = clock_step(before_, now);
  before_ = now;
  if (!step) return std::nullopt;
  return describe_clock_step(*step);
}

}  // namespace abcal
