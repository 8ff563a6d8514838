#pragma once

#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal::wire {

/// One call on a byte stream and its result: all that a driver can learn from its wire. The values of `Kind`
/// are stored in run files.
struct WireEvent {
  enum class Kind : char {
    kOpened = 'o',     ///< The stream is open; bytes: its name.
    kWritten = '>',    ///< write() was called with these bytes.
    kReceived = '<',   ///< read_until() returned these bytes; empty: none arrived in time.
    kDiscarded = 'x',  ///< discard_input() discarded these bytes; not noted if there were none.
    kDropped = 'd',    ///< dropped_bytes() has a new value; bytes: its decimal digits.
    kFailed = '!',     ///< The call threw; bytes: failure_text().
  };

  Kind kind = Kind::kOpened;
  Clock::Instant time;     ///< Beginning of a write; return of any other call.
  Clock::Instant arrival;  ///< Arrival of the last byte received, as the stream reported it.
  std::string bytes;

  bool operator==(const WireEvent&) const = default;
};

/// The calls that can fail.
enum class WireCall { kWrite, kRead, kDiscard };

struct WireFailure {
  WireCall call = WireCall::kRead;
  InstrumentError error;
};

/// "read\nlink lost\n/dev/ttyUSB0\nunplugged": call, fault, who, detail.
std::string failure_text(WireCall call, const InstrumentError& error);
/// Back from failure_text(). @throws std::invalid_argument for any other text.
WireFailure parse_failure(std::string_view text);

}  // namespace abcal::wire
