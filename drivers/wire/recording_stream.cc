#include "drivers/wire/recording_stream.h"

#include <fmt/format.h>

#include <iterator>
#include <ostream>
#include <utility>

namespace abcal::wire {

RecordingStream::RecordingStream(std::unique_ptr<ByteStream> inner, const Clock& clock, std::ostream& log)
    : inner_(std::move(inner)), clock_(clock), start_(clock.now()), log_(log) {}

void RecordingStream::write(std::string_view bytes) {
  note('>', bytes, clock_.now());  // Before the write: a command that kills the link is still on file.
  inner_->write(bytes);
}

ReceivedBytes RecordingStream::read_until(Clock::Instant deadline) {
  ReceivedBytes received = inner_->read_until(deadline);
  note('<', received.bytes, received.arrival);
  return received;
}

void RecordingStream::discard_input() {
  // Read rather than dropped: a replay must know also what nobody wanted.
  for (;;) {
    const ReceivedBytes received = inner_->read_until(clock_.now());
    if (received.bytes.empty()) return;
    note('<', received.bytes, received.arrival);
  }
}

std::size_t RecordingStream::dropped_bytes() const {
  return inner_->dropped_bytes();
}

std::string RecordingStream::name() const {
  return inner_->name();
}

void RecordingStream::note(char direction, std::string_view bytes, Clock::Instant when) {
  if (bytes.empty()) return;
  std::string line = fmt::format("{} {} ", (when - start_).count(), direction);
  for (const char byte : bytes) {
    fmt::format_to(std::back_inserter(line), "{:02x}", static_cast<unsigned char>(byte));
  }
  line += '\n';
  const std::lock_guard lock(log_mutex_);
  log_ << line;
}

}  // namespace abcal::wire
