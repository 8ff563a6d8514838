#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/correction_registers.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/reading_stream.h"
#include "drivers/witmotion/codec.h"

namespace abcal {

/// A WitMotion sensor (WT61, WT901, HWT901 and similar models), used for its accelerometers: output in g,
/// sign as in witmotion::Acceleration.
///
/// It streams from power on. Cheap models answer no question, so it is identified by its frames, and its
/// settings are confirmed by its subsequent output. Changes the running configuration of the device, never
/// the stored one.
///
/// Its frames have no counter: readings that were damaged on the line are counted as lost, those that vanish
/// without leaving a byte cannot be counted (wire::ReadingStream).
class WitMotionAccelerometer final : public Accelerometer, public CorrectionRegisters {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  WitMotionAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                         const AccelerometerSettings& settings);

  /// Listens for its frames and asks for version, range and baud rate. Values that it does not report are
  /// "unknown"; so are the model (always) and the serial number (empty). A started stream must be started
  /// again.
  /// @throws InstrumentError kNoReply, kWrongIdentity, kBadFrame (everything received was damaged), each
  /// quoting what was received.
  AccelerometerInfo identify() override;

  /// The offsets (05 to 07), where it answers.
  std::map<std::string, std::string> correction_registers() override;

  // The offsets; it has no scales.
  CorrectionRegisters* corrections() override { return this; }
  CorrectionAbility ability() override;
  OutputCorrection decode(const RegisterTexts& registers) override;
  RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) override;
  void write(const RegisterTexts& registers) override;
  /// With the output and the rate that it had when this program first asked: all registers are stored.
  void save(const RegisterTexts& registers) override;

  /// Identifies, sets output and rate, and waits until it is seen to stream at that rate.
  /// @throws InstrumentError kRefused if there is no such rate or the link is too slow for it, kNoReply if no
  /// readings arrive then, kImplausible if they arrive at another rate.
  void start() override;

  /// @throws InstrumentError kNotReady if it was restarted and has lost its settings.
  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override;
  StreamHealth health() const override { return readings_.health(); }
  /// Stops listening. The device streams on: a silent one could not be distinguished from a failed one.
  void stop() noexcept override { readings_.end(); }

 private:
  using Registers = std::array<std::uint16_t, 4>;

  [[noreturn]] void fail(Fault fault, std::string_view detail) const;
  [[noreturn]] void fail_without_frames(Clock::Duration waited) const;
  AccelerometerInfo interrogate();
  std::optional<Registers> ask(witmotion::Register first);
  void check_link() const;
  void configure_output(std::uint16_t rate_code);
  void send(witmotion::Register where, std::uint16_t value);
  std::optional<Reading> take(const witmotion::Frame& frame);

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  AccelerometerSettings settings_;
  std::string instrument_;  ///< For messages.
  wire::ReadingStream<witmotion::FrameParser> readings_;

  std::optional<std::uint16_t> version_;
  std::optional<double> link_bytes_per_s_;
  std::optional<Registers> found_output_;  ///< 02 and 03 as they were when it was first asked.
  std::optional<Registers> answer_;        ///< To the question asked last, if any.
  bool answers_doubtful_ = false;   ///< A question went unanswered: a late answer would pass for another's.
  std::uint64_t frames_ = 0;        ///< Since the stream began.
  std::uint64_t other_frames_ = 0;  ///< Since the stream began: neither acceleration nor answer.
  bool only_acceleration_ = false;  ///< Started, with the output mask that was set.
};

}  // namespace abcal
