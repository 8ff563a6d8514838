#pragma once

#include <atomic>
#include <functional>
#include <memory>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/wire_event.h"

namespace abcal::wire {

/// Passes everything through to another stream and reports every call to a sink, so that a ReplayStream can
/// give a driver the same outcomes again.
///
/// Reads that returned nothing are reported too: the driver's next step depends on the bytes available at its
/// read, which do not follow from times of arrival alone.
class RecordingStream final : public ByteStream {
 public:
  /// Called in the thread that made the call, also in several at once; must not throw.
  using Sink = std::function<void(WireEvent&&)>;

  /// The sink is notified at once that `inner` is open.
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
  mutable std::atomic<std::size_t> dropped_ = 0;  ///< Count that was recorded last.
};

}  // namespace abcal::wire
