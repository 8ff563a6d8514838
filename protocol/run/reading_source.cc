#include "protocol/run/reading_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal {

std::vector<Reading> ReadingSource::read(std::size_t count) {
  std::vector<Reading> readings;
  readings.reserve(count);
  while (readings.size() < count) readings.push_back(read_one());
  return readings;
}

Reading ReadingSource::read_one() {
  const StoppableClock& clock = context_.clock;
  const double timeout_s = context_.settings.protocol.reading_timeout_s;
  const Clock::Instant deadline = clock.now() + from_seconds(timeout_s);
  while (true) {
    clock.throw_if_stopped();
    const Clock::Instant now = clock.now();
    if (auto reading = accelerometer_.next(std::min(deadline, now + StoppableClock::kSlice))) {
      return *std::move(reading);
    }
    if (clock.now() >= deadline) {
      throw InstrumentError(context_.accelerometer_name(), Fault::kNoReply,
                            fmt::format("no reading for {} s (reading_timeout_s), after {} readings. Check "
                                        "the cable, the supply, and whether another program has stopped it",
                                        timeout_s, accelerometer_.health().readings));
    }
  }
}

}  // namespace abcal
