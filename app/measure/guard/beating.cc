#include "app/measure/guard/beating.h"

#include <algorithm>

namespace abcal {

void BeatingClock::sleep_until(Instant instant) {
  do {
    guard_->beat("the time");
    clock_->sleep_until(std::min(instant, clock_->now() + kSlice));
  } while (clock_->now() < instant);
  guard_->beat("the time");
}

void BeatingStream::write(std::string_view bytes) {
  guard_->beat("room for bytes on " + stream_->name());
  stream_->write(bytes);
}

wire::ReceivedBytes BeatingStream::read_until(Clock::Instant deadline) {
  while (true) {
    const Clock::Instant slice = std::min(deadline, clock_.now() + BeatingClock::kSlice);
    wire::ReceivedBytes received = stream_->read_until(slice);
    guard_->beat("bytes from " + stream_->name());
    if (!received.bytes.empty() || slice >= deadline) return received;
  }
}

}  // namespace abcal
