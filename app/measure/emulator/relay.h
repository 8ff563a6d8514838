#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "app/measure/emulator/wire_log.h"
#include "drivers/wire/byte_stream.h"
#include "sim/firmware/firmware.h"

namespace abcal {

/// A real instrument, served like a simulated one: bytes pass through in both directions and are logged.
class Relay final : public sim::Firmware {
 public:
  /// @param log outlives the relay
  /// @param start  the instant at which the log began
  Relay(std::unique_ptr<wire::ByteStream> instrument, WireLogWriter& log, Clock::Instant start);

  /// @throws InstrumentError kLinkLost
  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override { return next_look_; }

 private:
  std::unique_ptr<wire::ByteStream> instrument_;
  WireLogWriter& log_;
  Clock::Instant start_;
  Clock::Instant next_look_;
};

}  // namespace abcal
