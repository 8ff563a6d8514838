#pragma once

#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal::wire {

/// One call on a byte stream and what came of it: all that a driver can learn from its wire. The values of
/// `Kind` are what a run file stores.
struct WireEvent {
  enum class Kind : char {
    kOpened = 'o',     ///< The stream is there; bytes: its name.
    kWritten = '>',    ///< write() was called with these bytes.
    kReceived = '<',   ///< read_until() gave these bytes; none: it came back empty-handed.
    kDiscarded = 'x',  ///< discard_input() threw these bytes away; not noted if there were none.
    kDropped = 'd',    ///< dropped_bytes() has a new value; bytes: its decimal digits.
    kFailed = '!',     ///< The call threw; bytes: failure_text().
  };

  Kind kind = Kind::kOpened;
  Clock::Instant time;     ///< When a write was begun; when any other call came back.
  Clock::Instant arrival;  ///< Of the last of the bytes received, as the stream gave it.
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
