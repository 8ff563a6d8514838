#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/packet_accelerometer.h"
#include "drivers/xsens_mti/codec.h"

namespace abcal {

/// An Xsens (Movella) MTi sensor that speaks Xbus with MTData2, used for its accelerometers: output in m/s2,
/// sign as in xbus::decode_acceleration.
///
/// Every exchange begins with "go to config", so that an answer can be distinguished from the stream; an
/// answer is recognised by its message id, so data and late answers in between are ignored. The packet
/// counter shows how many readings are missing. An MTi keeps an output configuration once set, also without
/// power: start() changes it permanently (the documentation of this driver describes how to restore it).
class XsensMtiAccelerometer final : public wire::PacketAccelerometer<xbus::MessageParser> {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  XsensMtiAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                        const AccelerometerSettings& settings);

  /// Identifies, sets the output configuration and begins the measurement. next() then throws kRefused if the
  /// device reports an error of its own, kNotReady if it was restarted.
  /// @throws InstrumentError kRefused also if the device makes another rate than the wanted one, or if the
  /// link is too slow.
  void start() override;

 private:
  struct Request {
    std::uint8_t id = 0;
    std::string data;
    std::string_view name;  ///< For messages: "product code".
  };

  // Commands. None of them is sent while it streams.
  std::string exchange(const Request& request);
  wire::PacketAnswer try_exchange(const Request& request);
  void make_quiet() override;
  AccelerometerInfo interrogate() override;
  void configure_output();

  // Data.
  wire::DecodedFrame decode(const xbus::Message& message) override;
  wire::DecodedFrame decode_data(const xbus::Message& message);
  void check_sample_time(std::uint32_t sample_time);

  // Since start().
  double rate_hz_ = 0.0;         ///< Rate that the device reported; 0 before.
  bool counts_packets_ = false;  ///< It puts a packet counter into each.
  std::optional<std::uint16_t> last_packet_counter_;
  std::optional<std::uint32_t> last_sample_time_;
  std::uint64_t lost_packets_ = 0;  ///< Since the last reading.
  std::optional<double> temperature_degc_;
  Clock::Instant temperature_arrival_;
};

}  // namespace abcal
