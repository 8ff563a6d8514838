#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/microstrain_mip/codec.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// A MicroStrain inertial sensor that speaks MIP (3DM-GX3 to -GX5, CX5, CV5, CV7, GV7...), used for its
/// accelerometers: scaled output in g, sign as in mip::decode_scaled_accelerometer.
///
/// Every exchange begins with "set idle", so that an answer can be told from what was streaming; an answer is
/// known by its descriptor set and by the echo of its command, so data packets and late answers in between do
/// no harm. Changes the running configuration of the device, never the stored one.
class MipAccelerometer final : public Accelerometer {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  MipAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                   const AccelerometerSettings& settings);

  AccelerometerInfo identify() override;

  /// Identifies (the device may have been changed or restarted), sets the message format and lets the data
  /// flow.
  /// @throws InstrumentError kRefused also if no decimation gives rate_hz within 1 %, or if the link is too
  /// slow.
  void start() override;

  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override;
  StreamHealth health() const override;
  void stop() noexcept override;

 private:
  /// What identify() found out, as far as start() needs it.
  struct Abilities {
    bool modern = false;  ///< 0C,0E and 0C,0F instead of 0C,06 and 0C,08.
    bool stream_control = false;
    bool reference_time = false;
    bool gps_timestamp = false;
    bool temperature = false;
    bool over_range = false;
    std::vector<std::uint8_t> other_data_sets;
    std::uint16_t base_rate_hz = 0;
    std::uint16_t decimation = 1;
  };

  /// A command and where its answer is to be found.
  struct Command {
    std::uint8_t set = 0;
    std::uint8_t descriptor = 0;
    std::string data;
    std::string_view name;  ///< For messages: "device info".
    std::optional<std::uint8_t>
        reply_field;  ///< Descriptor of the field that must come with the acknowledgement.
  };

  Clock::Duration reply_deadline() const;
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;

  void set_idle();
  /// @return the data of the reply field (empty if none is asked for).
  std::string exchange(const Command& command);
  /// Waits for the answer; nothing at the deadline. @throws kRefused.
  std::optional<std::string> await_reply(const Command& command, Clock::Instant deadline);
  std::optional<std::string> match_reply(const mip::Packet& packet, const Command& command) const;

  AccelerometerInfo interrogate();
  double rate_hz() const;
  std::vector<mip::FormatEntry> wanted_format() const;

  void receive(const wire::ReceivedBytes& received);
  void drain_parser();
  void take_packet(const mip::Packet& packet);
  /// Readings made since the last one, this one included (1: none lost).
  std::uint64_t readings_since_last(const std::vector<mip::Field>& fields);
  std::uint64_t unframed_bytes() const;

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  AccelerometerSettings settings_;

  std::string who_;  ///< For messages.
  Abilities abilities_;
  bool started_ = false;

  mip::PacketParser parser_;
  Clock::Instant last_arrival_;
  std::size_t dropped_at_start_ = 0;

  std::deque<Reading> queue_;
  StreamHealth health_;
  std::uint64_t next_sequence_ = 0;
  bool discard_next_reading_ = false;
  bool forgive_next_gap_ = false;
  std::optional<std::uint64_t> last_reference_time_ns_;
  std::optional<mip::GpsTimestamp> last_gps_timestamp_;
  std::uint64_t unframed_at_last_reading_ = 0;
  std::size_t reading_packet_bytes_ = 0;
  bool any_reading_ = false;
  std::optional<double> temperature_degc_;
  Clock::Instant temperature_arrival_;
};

}  // namespace abcal
