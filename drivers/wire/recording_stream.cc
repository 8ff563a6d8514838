#include "drivers/wire/recording_stream.h"

#include <utility>

namespace abcal::wire {

RecordingStream::RecordingStream(std::unique_ptr<ByteStream> inner, const Clock& clock, Sink sink)
    : inner_(std::move(inner)), clock_(clock), sink_(std::move(sink)) {
  note(WireEvent::Kind::kOpened, inner_->name());
}

void RecordingStream::write(std::string_view bytes) {
  // Before the write: a command that ends the link is still recorded, and no answer precedes its question.
  note(WireEvent::Kind::kWritten, std::string(bytes));
  try {
    inner_->write(bytes);
  } catch (const InstrumentError& error) {
    note_failure(WireCall::kWrite, error);
    throw;
  }
}

ReceivedBytes RecordingStream::read_until(Clock::Instant deadline) {
  try {
    ReceivedBytes received = inner_->read_until(deadline);
    received.for_each_group([this](std::string_view bytes, Clock::Instant arrival) {
      note(WireEvent::Kind::kReceived, std::string(bytes), arrival);
    });
    return received;
  } catch (const InstrumentError& error) {
    note_failure(WireCall::kRead, error);
    throw;
  }
}

void RecordingStream::discard_input() {
  // Read rather than dropped: discarded bytes are recorded too.
  std::string discarded;
  try {
    for (;;) {
      const std::string bytes = inner_->read_until(clock_.now()).bytes;
      if (bytes.empty()) break;
      discarded += bytes;
    }
  } catch (const InstrumentError& error) {
    if (!discarded.empty()) note(WireEvent::Kind::kDiscarded, std::move(discarded));
    note_failure(WireCall::kDiscard, error);
    throw;
  }
  if (!discarded.empty()) note(WireEvent::Kind::kDiscarded, std::move(discarded));
}

std::size_t RecordingStream::dropped_bytes() const {
  const std::size_t dropped = inner_->dropped_bytes();
  if (dropped_.exchange(dropped) != dropped) note(WireEvent::Kind::kDropped, std::to_string(dropped));
  return dropped;
}

std::string RecordingStream::name() const {
  return inner_->name();
}

void RecordingStream::note(WireEvent::Kind kind, std::string bytes, Clock::Instant arrival) const {
  sink_({kind, clock_.now(), arrival, std::move(bytes)});
}

void RecordingStream::note_failure(WireCall call, const InstrumentError& error) const {
  note(WireEvent::Kind::kFailed, failure_text(call, error));
}

}  // namespace abcal::wire
