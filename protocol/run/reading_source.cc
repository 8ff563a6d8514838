#include "protocol/run/reading_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

/// Time between two looks at the other items. Their drivers know when each reading arrived, however late it
/// is taken.
constexpr Clock::Duration kLookAtOthers = std::chrono::milliseconds(20);
/// Largest number of readings kept for an item that is not read; older ones are dropped.
constexpr std::size_t kMostWaiting = 65536;

}  // namespace

std::vector<Reading> ReadingSource::read(std::size_t count) {
  std::vector<Reading> readings;
  readings.reserve(count);
  while (readings.size() < count) readings.push_back(read_one());
  return readings;
}

std::vector<Reading> ReadingSource::take() {
  context_.clock.throw_if_stopped();
  take_waiting();
  std::vector<Reading> taken(waiting_.begin(), waiting_.end());
  waiting_.clear();
  if (taken.empty() && failure_) throw InstrumentError(*failure_);
  return taken;
}

Reading ReadingSource::read_one() {
  if (!waiting_.empty()) {
    Reading reading = std::move(waiting_.front());
    waiting_.pop_front();
    return reading;
  }
  if (failure_) throw InstrumentError(*failure_);
  const StoppableClock& clock = context_.clock;
  const double timeout_s = context_.settings.protocol.reading_timeout_s;
  const Clock::Instant deadline = clock.now() + from_seconds(timeout_s);
  while (true) {
    clock.throw_if_stopped();
    const Clock::Instant now = clock.now();
    const Clock::Duration slice = others_.empty() ? StoppableClock::kSlice : kLookAtOthers;
    auto reading = accelerometer_.next(std::min(deadline, now + slice));
    look_at_others();
    if (reading) return *std::move(reading);
    if (now >= deadline) {  // It was asked after the deadline, and had nothing.
      throw InstrumentError(
          context_.accelerometer_name(), Fault::kNoReply,
          Message("no reading for {seconds} s (reading_timeout_s), after {readings} readings. Check the "
                  "cable, the supply, and whether another program has stopped it",
                  timeout_s, accelerometer_.health().readings));
    }
  }
}

void ReadingSource::look_at_others() {
  if (others_.empty()) return;
  const Clock::Instant now = context_.clock.now();
  if (now < next_look_) return;
  for (ReadingSource* other : others_) other->take_waiting();
  next_look_ = now + kLookAtOthers;
}

void ReadingSource::take_waiting() {
  if (failure_) return;
  try {
    while (auto reading = accelerometer_.next(context_.clock.now())) {
      if (waiting_.size() == kMostWaiting) waiting_.pop_front();
      waiting_.push_back(*std::move(reading));
    }
  } catch (const InstrumentError& error) {
    failure_ = error;  // It is reported when this one is read.
  }
}

}  // namespace abcal
