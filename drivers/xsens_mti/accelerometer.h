#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/reading_queue.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/xsens_mti/codec.h"

namespace abcal {

/// An Xsens (Movella) MTi sensor that speaks Xbus with MTData2, used for its accelerometers: output in m/s2,
/// sign as in xbus::decode_acceleration.
///
/// Every exchange begins with "go to config", so that an answer can be told from what was streaming; an
/// answer is known by its message id, so data and late answers in between do no harm. The packet counter says
/// how many readings are missing. An MTi keeps an output configuration once set, also without power: start()
/// changes it for good (the documentation of this driver says how to put it back).
class XsensMtiAccelerometer final : public Accelerometer {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  XsensMtiAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                        const AccelerometerSettings& settings);

  /// Puts the device into config mode (so a started one must be started again) and asks what it is. `rate_hz`
  /// is the wanted one until start() has learned the real one.
  /// @throws InstrumentError kNoReply, kWrongIdentity, kBadFrame (all that came was damaged), each saying
  /// what came.
  AccelerometerInfo identify() override;

  /// Identifies, sets the output configuration and begins the measurement.
  /// @throws InstrumentError kRefused also if the device makes another rate than the wanted one, or if the
  /// link is too slow.
  void start() override;

  /// @throws InstrumentError kRefused if the device reports an error while it streams, kNotReady if it was
  /// restarted.
  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override;
  StreamHealth health() const override;
  void stop() noexcept override;

 private:
  struct Command {
    std::uint8_t id = 0;
    std::string data;
    std::string_view name;  ///< For messages: "product code".
  };

  /// The data of the answer, or the code of an error.
  struct Answer {
    std::string data;
    std::optional<unsigned> error;
  };

  /// What came in while an answer was awaited; for the message if none came.
  struct Evidence {
    std::size_t bytes = 0;
    std::string first_bytes;
    std::size_t messages = 0;
    std::uint64_t bad_messages = 0;
  };

  // Commands. None of them is sent while started_.
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;
  [[noreturn]] void refuse(const Command& command, unsigned error) const;
  [[noreturn]] void fail_without_answer(const Command& command, const Evidence& evidence,
                                        Clock::Duration waited) const;
  std::string exchange(const Command& command);
  Answer try_exchange(const Command& command);
  bool settle();
  std::optional<Answer> ask(const Command& command, bool heed_errors, Evidence& evidence);
  std::optional<Answer> await_answer(const Command& command, bool heed_errors, Clock::Instant deadline,
                                     Evidence& evidence);
  void go_to_config();
  AccelerometerInfo interrogate();
  void configure_output();
  void check_link(double rate_hz) const;

  // Data.
  void receive(const wire::ReceivedBytes& received);
  void take_message(const xbus::Message& message);
  void take_data(const xbus::Message& message);
  void check_sample_time(std::uint32_t sample_time);
  std::uint64_t unframed_bytes() const;
  void end_stream() noexcept;

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  AccelerometerSettings settings_;
  std::string who_;  ///< For messages.
  xbus::MessageParser parser_;
  bool answers_outstanding_ = false;  ///< A command went unanswered: its answer may still come.

  // Since start().
  bool started_ = false;
  double rate_hz_ = 0.0;         ///< As the device said; 0 before.
  bool counts_packets_ = false;  ///< It puts a packet counter into each.
  ReadingQueue readings_;
  std::uint64_t malformed_ = 0;  ///< Messages with a right checksum and impossible content.
  std::uint64_t malformed_bytes_ = 0;
  std::uint64_t bad_frames_at_end_ = 0;
  std::uint64_t skipped_bytes_at_end_ = 0;
  std::size_t dropped_at_start_ = 0;
  std::size_t dropped_at_discard_ = 0;
  std::uint64_t unframed_at_last_reading_ = 0;
  std::size_t last_reading_bytes_ = 0;
  Clock::Instant last_arrival_;
  std::optional<std::uint16_t> last_packet_counter_;
  std::optional<std::uint32_t> last_sample_time_;
  std::uint64_t lost_packets_ = 0;  ///< Since the last reading.
  std::optional<double> temperature_degc_;
  Clock::Instant temperature_arrival_;
};

}  // namespace abcal
