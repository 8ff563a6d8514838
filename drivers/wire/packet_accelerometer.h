#pragma once

#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/packet_exchange.h"
#include "drivers/wire/reading_stream.h"

namespace abcal::wire {

/// An accelerometer that streams packets and answers commands in between: the common part of these drivers. A
/// driver implements how the instrument is queried (interrogate), made quiet and started, and how its packets
/// are decoded.
template <class Parser>
class PacketAccelerometer : public Accelerometer {
 public:
  /// Stops the stream (so a started instrument must be started again) and queries the identity.
  /// @throws InstrumentError kNoReply, kWrongIdentity, kBadFrame (everything received was damaged), each
  /// quoting what was received.
  AccelerometerInfo identify() final { return interrogate(); }

  std::optional<Reading> next(Clock::Instant deadline) final {
    if (!readings_.running()) fail(Fault::kNotReady, "asked for a reading before it was started");
    return readings_.next(deadline);
  }

  void discard_pending() final {
    if (readings_.running()) readings_.discard_pending(clock_.now());
  }

  StreamHealth health() const final { return readings_.health(); }

  void stop() noexcept final {
    try {
      make_quiet();
    } catch (...) {
      // On the way out: by the interface, failure is not reported.
    }
    readings_.end();
  }

 protected:
  using Exchange = PacketExchange<Parser>;
  using Command = typename Exchange::Command;
  using Packet = typename Exchange::Packet;

  /// `driver`: as in a bench file. @throws std::invalid_argument if settings.rate_hz is not a positive number
  /// or stream is null.
  PacketAccelerometer(std::string_view driver, std::unique_ptr<ByteStream> stream, Clock& clock,
                      const AccelerometerSettings& settings, typename Exchange::Manner manner)
      : stream_(stream ? std::move(stream)
                       : throw std::invalid_argument(fmt::format("accelerometer {}: no stream", driver))),
        clock_(clock),
        settings_(settings),
        readings_(*stream_, Parser(), [this](const Packet& packet) { return decode(packet); }),
        exchange_(*stream_, readings_, clock_, fmt::format("accelerometer {} on {}", driver, stream_->name()),
                  std::move(manner)) {
    if (settings_.rate_hz > 0.0 && std::isfinite(settings_.rate_hz)) return;
    throw std::invalid_argument(fmt::format("accelerometer {}: rate_hz is {}; required: a positive number",
                                            driver, settings_.rate_hz));
  }

  /// Stops the stream and queries the identity.
  virtual AccelerometerInfo interrogate() = 0;
  /// Ends the stream, so that answers can be distinguished from data.
  virtual void make_quiet() = 0;
  /// Decodes a packet of the stream; called while it runs.
  virtual DecodedFrame decode(const Packet& packet) = 0;

  [[noreturn]] void fail(Fault fault, std::string_view detail) const { exchange_.fail(fault, detail); }
  [[noreturn]] void end_and_fail(Fault fault, std::string_view detail) {
    readings_.end();
    fail(fault, detail);
  }

  /// Called once the instrument has identified itself: messages then name it.
  void name_it(std::string_view model, std::string_view serial_number) {
    exchange_.rename(fmt::format("accelerometer {} (SN {}) on {}", model, serial_number, stream_->name()));
  }

  /// @throws InstrumentError kRefused if the link cannot carry this many bytes. `rate_hz` readings a second
  /// need `bytes_per_s`; `most_hz` is the rate that it carries.
  void check_link(double rate_hz, double bytes_per_s, std::optional<double> link_bytes_per_s,
                  double most_hz) const {
    if (!link_bytes_per_s || bytes_per_s <= *link_bytes_per_s) return;
    fail(Fault::kRefused,
         fmt::format("{:.6g} readings per second need {:.0f} bytes/s, but the link carries {:.0f}: lower "
                     "rate_hz to {:.0f} or less, or raise the baud rate of the device",
                     rate_hz, bytes_per_s, *link_bytes_per_s, std::floor(most_hz)));
  }

  const std::unique_ptr<ByteStream> stream_;
  Clock& clock_;
  const AccelerometerSettings settings_;
  ReadingStream<Parser> readings_;
  Exchange exchange_;
};

}  // namespace abcal::wire
