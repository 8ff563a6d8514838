#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// The inside of a simulated instrument at byte level: what the maker's manual says of the bytes, without a
/// port. Time is handed in, so that the same firmware serves the jumping clock and real time. One thread.
class Firmware {
 public:
  virtual ~Firmware() = default;

  /// The instrument's port took these bytes at `now`. Any split is allowed.
  virtual void receive(std::string_view bytes, Clock::Instant now) = 0;

  /// The bytes that the instrument has put out since the last call and up to `now`.
  virtual std::string transmit(Clock::Instant now) = 0;

  /// When it next has bytes to put out if nothing more is received; nothing: never. May have passed.
  virtual std::optional<Clock::Instant> next_due() const = 0;

  /// Whether its plug is in: an emulator takes the port of an unplugged one away.
  virtual bool plugged_in() const { return true; }
};

}  // namespace abcal::sim
