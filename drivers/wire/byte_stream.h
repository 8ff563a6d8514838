#pragma once

#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"

namespace abcal::wire {

/// Received bytes, with the time of arrival of the last one.
struct ReceivedBytes {
  std::string bytes;
  Clock::Instant arrival;
};

/// A two-way stream of bytes to an instrument: serial port, TCP, simulated firmware, recording.
///
/// One thread reads; any thread may write (one write is never torn by another).
/// All calls throw InstrumentError with Fault::kLinkLost once the port has closed or vanished.
class ByteStream {
 public:
  virtual ~ByteStream() = default;

  /// Writes all of `bytes`, or throws (kNoReply if the port takes none within its write deadline).
  virtual void write(std::string_view bytes) = 0;

  /// Waits until at least one byte has arrived and returns all bytes that have, oldest first; empty at the
  /// deadline. With a deadline in the past it returns the bytes that have already arrived.
  virtual ReceivedBytes read_until(Clock::Instant deadline) = 0;

  /// Discards all input that has arrived.
  virtual void discard_input() = 0;

  /// Bytes dropped because the bounded input queue was full; never decreases.
  virtual std::size_t dropped_bytes() const { return 0; }

  /// For messages: "/dev/ttyUSB0", "tcp:192.168.0.7:50000", "simulated".
  virtual std::string name() const = 0;
};

}  // namespace abcal::wire
