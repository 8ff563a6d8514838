#pragma once

#include <array>
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
#include "drivers/vectornav/codec.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// A VectorNav inertial sensor (VN-100, VN-200, VN-300 and their like), used for its accelerometers:
/// compensated output in m/s2, sign as in vectornav::Measurement.
///
/// The asynchronous output is paused while it is configured, and an answer is known by its command and
/// register, so data and late answers in between do no harm. Output is binary with the device's time, so that
/// a gap says how many readings are missing; where register 75 is refused it is the text message IMU, or else
/// ACC. Changes the running configuration of the device, never the stored one.
class VectorNavAccelerometer final : public Accelerometer {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  VectorNavAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                         const AccelerometerSettings& settings);

  /// Pauses the output (so a started one must be started again) and asks what it is.
  /// @throws InstrumentError kNoReply, kWrongIdentity, kBadFrame (all that came was damaged), each saying
  /// what came.
  AccelerometerInfo identify() override;

  /// Identifies, sets the output and lets it flow.
  /// @throws InstrumentError kRefused also if the rate cannot be made within 1 %, or if the link is too slow.
  void start() override;

  /// @throws InstrumentError kRefused if the device reports an error while it streams ("VNERR"), kNotReady if
  /// it was restarted, kImplausible if its time stamps contradict the configured rate.
  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override;
  StreamHealth health() const override;
  void stop() noexcept override;

 private:
  enum class Output { kBinary, kImuText, kAccelerationText };

  /// What came in while an answer was awaited; for the message if none came.
  struct Evidence {
    std::size_t bytes = 0;
    std::string first_bytes;
    std::size_t messages = 0;
    std::uint64_t bad_checksums = 0;
  };

  /// What the device says to a command: the words behind command and register, or the code of "VNERR".
  struct Answer {
    std::string values;
    std::optional<unsigned> error;
  };

  // Commands. None of them is sent while started_.
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;
  [[noreturn]] void refuse(std::string_view command, unsigned error) const;
  [[noreturn]] void fail_without_answer(std::string_view command, const Evidence& evidence,
                                        Clock::Duration waited) const;
  std::string exchange(std::string_view command);
  Answer try_exchange(std::string_view command);
  std::optional<Answer> ask(std::string_view command, bool heed_errors, Evidence& evidence);
  std::optional<Answer> await_answer(std::string_view command, bool heed_errors, Clock::Instant deadline,
                                     Evidence& evidence);
  bool settle();
  void pause_output();
  AccelerometerInfo interrogate();
  bool try_binary_output();
  void set_text_output();
  void check_rate(double rate_hz, std::string_view possible) const;
  void check_link(double rate_hz, std::size_t message_bytes) const;

  // Data.
  void receive(const wire::ReceivedBytes& received);
  void take_message(const vectornav::Message& message);
  std::uint64_t steps_since_last_reading(std::optional<std::uint64_t> time_startup_ns);
  void check_period(double period_s);
  std::uint64_t unframed_bytes() const;
  void end_stream() noexcept;

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  AccelerometerSettings settings_;
  std::string who_;             ///< For messages.
  unsigned imu_rate_hz_ = 800;  ///< Of which a binary output is a whole division.
  std::optional<double> link_bytes_per_s_;
  vectornav::MessageParser parser_;
  bool answers_outstanding_ = false;  ///< A command went unanswered: its answer may still come.

  // Since start().
  bool started_ = false;
  Output output_ = Output::kBinary;
  double rate_hz_ = 0.0;
  std::size_t message_bytes_ = 0;
  ReadingQueue readings_;
  std::uint64_t malformed_ = 0;  ///< Messages with a right checksum and impossible content.
  std::uint64_t bad_frames_at_end_ = 0;
  std::uint64_t skipped_bytes_at_end_ = 0;
  std::size_t dropped_at_start_ = 0;
  std::size_t dropped_at_discard_ = 0;
  std::uint64_t unframed_at_last_reading_ = 0;
  Clock::Instant last_arrival_;
  std::optional<std::uint64_t> last_time_ns_;
  unsigned periods_seen_ = 0;
  double shortest_period_s_ = 0.0;
};

}  // namespace abcal
