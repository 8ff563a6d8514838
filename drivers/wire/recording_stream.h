#pragma once

#include <atomic>
#include <functional>
#include <memory>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/wire_event.h"

namespace abcal::wire {

/// Passes everything through to another stream and tells a sink of every call, so that a ReplayStream can
/// give a driver the same outcomes again.
///
/// Reads that returned nothing are reported too: which bytes were there when the driver looked decides what
/// it does next, and does not follow from times of arrival alone.
class RecordingStream final : public ByteStream {
 public:
  /// Called in the thread that made the call, also in several at once; must not throw.
  using Sink = std::function<void(WireEvent&&)>;

  /// The sink is told at once that `inner` is open.
  RecordingStream(std::unique_ptr<ByteStream> inner, const Clock& clock, Sink sink);

  void write(std::string_view bytes) override;
  ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override;
  std::string name() const override;

 private:
  void note(WireEvent::Kind kind, std::string bytes, Clock::Instant arrival = {}) const;
  void note_failure(WireCall call, const InstrumentError& error) const;

  std::unique_ptr<ByteStream> inner_;
  const Clock& clock_;
  Sink sink_;
  mutable std::atomic<std::size_t> dropped_ = 0;  ///< As told last.
};

}  // namespace abcal::wire
