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
#include "drivers/instrument/correction_registers.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/vectornav/codec.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/packet_accelerometer.h"

namespace abcal {

/// A VectorNav inertial sensor (VN-100, VN-200, VN-300 and their like), used for its accelerometers:
/// compensated output in m/s2, sign as in vectornav::Measurement.
///
/// The asynchronous output is paused while it is configured, and an answer is recognised by its command and
/// register, so data and late answers in between do no harm. Output is binary with the device's time, so that
/// a gap shows how many readings are missing; if register 75 is refused, it is the text message IMU, or else
/// ACC. Changes the running configuration of the device, never the stored one.
class VectorNavAccelerometer final : public wire::PacketAccelerometer<vectornav::MessageParser>,
                                     public CorrectionRegisters {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  VectorNavAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                         const AccelerometerSettings& settings);

  /// Identifies, sets the output and lets it flow. next() then throws kRefused if the device reports an error
  /// of its own, kNotReady if it was restarted, kImplausible if its time stamps contradict the configured
  /// rate.
  /// @throws InstrumentError kRefused also if the rate cannot be made within 1 %, or if the link is too slow.
  void start() override;

  /// Registers 25 (acceleration compensation) and 26 (rotation of the reference frame).
  std::map<std::string, std::string> correction_registers() override;

  // Register 25.
  CorrectionRegisters* corrections() override { return this; }
  CorrectionAbility ability() override;
  OutputCorrection decode(const RegisterTexts& registers) override;
  RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) override;
  void write(const RegisterTexts& registers) override;
  /// Restarts the device, which restores its stored settings, writes the register and stores all.
  void save(const RegisterTexts& registers) override;

 private:
  enum class Output { kBinary, kImuText, kAccelerationText };

  // Commands. None of them is sent while it streams.
  [[noreturn]] void refuse(std::string_view command, unsigned error) const;
  std::string exchange(std::string_view command);
  wire::PacketAnswer try_exchange(std::string_view command);
  void make_quiet() override;
  AccelerometerInfo interrogate() override;
  bool try_binary_output();
  void set_text_output();
  void check_rate(double rate_hz, std::string_view possible) const;
  void check_message_rate(double rate_hz, std::size_t message_bytes) const;

  // Data.
  wire::DecodedFrame decode(const vectornav::Message& message) override;
  std::optional<std::uint64_t> steps_since_last_reading(std::optional<std::uint64_t> time_startup_ns);
  void check_period(double period_s);

  unsigned imu_rate_hz_ = 800;  ///< Output rates are this value divided by a whole number.
  std::optional<double> link_bytes_per_s_;

  // Since start().
  Output output_ = Output::kBinary;
  double rate_hz_ = 0.0;
  std::optional<std::uint64_t> last_time_ns_;
  unsigned periods_seen_ = 0;
  double shortest_period_s_ = 0.0;
};

}  // namespace abcal
