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

  /// Sets the device idle (so a started one must be started again) and asks what it is. `rate_hz` is the real
  /// one.
  /// @throws InstrumentError kNoReply, kWrongIdentity (something else answers, or a MIP device without
  /// accelerometer), kBadFrame (MIP packets, all damaged), each saying what was found.
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
  /// What the device offers and how it is to be configured.
  struct Abilities {
    bool modern = false;  ///< 0C,0E and 0C,0F; else 0C,06 and 0C,08.
    bool stream_control = false;
    bool reference_time = false;
    bool gps_timestamp = false;
    bool temperature = false;
    bool over_range = false;
    std::vector<std::uint8_t> other_data_sets;  ///< Of the filter, GNSS...: they share the line.
    std::uint16_t base_rate_hz = 0;
    std::uint16_t decimation = 1;
  };

  struct Command {
    std::uint8_t set = 0;
    std::uint8_t descriptor = 0;
    std::string data;
    std::string_view name;  ///< For messages: "device info".
    std::optional<std::uint8_t>
        reply_field;  ///< Descriptor of the field that must come with the acknowledgement.
  };

  /// What came in while an answer was awaited; for the message if none came.
  struct Evidence {
    std::size_t bytes = 0;
    std::string first_bytes;
    std::size_t packets = 0;
    std::uint64_t bad_checksums = 0;
  };

  // Commands. None of them is sent while started_.
  Clock::Duration reply_deadline() const;
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;
  [[noreturn]] void fail_without_answer(const Command& command, const Evidence& evidence,
                                        Clock::Duration waited) const;
  void set_idle();
  std::string exchange(const Command& command);
  std::optional<std::string> ask(const Command& command, Evidence& evidence);
  std::optional<std::string> await_reply(const Command& command, Clock::Instant deadline, Evidence& evidence);
  std::optional<std::string> match_reply(const mip::Packet& packet, const Command& command) const;
  AccelerometerInfo interrogate();
  double rate_hz() const;
  std::vector<mip::FormatEntry> wanted_format() const;
  void check_rate_and_link(const std::vector<mip::FormatEntry>& format) const;
  void select_streams();

  // Data.
  void receive(const wire::ReceivedBytes& received, bool keep);
  void take_packet(const mip::Packet& packet, bool keep);
  std::uint64_t steps_since_last_reading(std::optional<std::uint64_t> reference_time_ns,
                                         const std::optional<mip::GpsTimestamp>& gps_timestamp);
  std::uint64_t unframed_bytes() const;
  void end_stream() noexcept;

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  AccelerometerSettings settings_;
  std::string who_;  ///< For messages.
  Abilities abilities_;
  mip::PacketParser parser_;
  bool answers_outstanding_ = false;  ///< A command went unanswered: its answer may still come.

  // Since start().
  bool started_ = false;
  std::deque<Reading> queue_;
  StreamHealth health_;  ///< Without what parser_ and stream_ count.
  std::size_t dropped_at_start_ = 0;
  std::uint64_t malformed_bytes_ = 0;  ///< In packets with a right checksum and impossible fields.
  Clock::Instant last_arrival_;
  std::optional<std::uint64_t> last_sequence_;
  std::optional<std::uint64_t> last_reference_time_ns_;
  std::optional<mip::GpsTimestamp> last_gps_timestamp_;
  std::uint64_t unframed_at_last_reading_ = 0;
  std::size_t last_reading_packet_bytes_ = 0;
  std::size_t dropped_at_discard_ = 0;
  bool discard_next_reading_ = false;
  bool forgive_next_gap_ = false;
  std::optional<double> temperature_degc_;
  Clock::Instant temperature_arrival_;
};

}  // namespace abcal
