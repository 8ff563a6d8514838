#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/iio/codec.h"
#include "drivers/iio/session.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/correction_registers.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/reading_queue.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::iio {

/// An accelerometer of Linux's Industrial I/O, by the text protocol of the iiod of its machine: u, v, w are
/// accel_x, accel_y, accel_z, output in m/s2, (raw + offset) * scale as the kernel gives them. The
/// corrections in the part itself (calibbias, calibscale) are in force and kept as correction registers.
///
/// Samples come in blocks of 20 ms from the kernel's buffer, which holds 2.5 s. A time stamp, if the scans of
/// the device have one, shows how many are missing; without it losses are not detected.
class IioAccelerometer final : public Accelerometer, public CorrectionRegisters {
 public:
  /// Sends nothing yet. @throws std::invalid_argument if settings.rate_hz is not a positive number or stream
  /// is null.
  IioAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                   const AccelerometerSettings& settings);

  AccelerometerInfo identify() override;
  std::map<std::string, std::string> correction_registers() override;

  // calibbias, and calibscale where it has one: output = scale (calibscale raw + calibbias). docs/apply.md
  // explains the meaning of the texts for each kernel driver.
  CorrectionRegisters* corrections() override { return this; }
  CorrectionAbility ability() override;
  OutputCorrection decode(const RegisterTexts& registers) override;
  RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) override;
  void write(const RegisterTexts& registers) override;
  /// @throws InstrumentError kRefused, always: Industrial I/O has no attribute for it
  void save(const RegisterTexts& registers) override;
  /// Identifies, sets the rate and the trigger, and opens the buffer.
  /// @throws InstrumentError kRefused: the rate is not one of the device's, or it gives no buffer.
  void start() override;
  /// A block that does not arrive is lost after 2 s, possibly 2 s after the deadline.
  std::optional<Reading> next(Clock::Instant deadline) override;
  /// Closes the buffer and opens it again, because the kernel keeps the oldest samples.
  void discard_pending() override;
  StreamHealth health() const override;
  void stop() noexcept override;

 private:
  const Device& device() const { return context_.devices[chosen_]; }
  std::size_t choose_device() const;
  std::string attribute(std::string_view channel, std::string_view name);
  double number_of_attribute(std::string_view channel, std::string_view name);
  std::optional<std::string> debug_text(std::string_view name);
  double scale_of(const RegisterTexts& registers, std::string_view axis) const;
  double calibscale_step(const RegisterTexts& registers, std::string_view axis) const;
  void read_scales();
  void set_rate();
  void set_trigger();
  void close_buffer();
  void open_buffer();
  void end_block();
  void take_block(const Samples& samples);
  void take_scan(std::string_view scan);
  std::uint64_t steps_to(std::int64_t time_ns);
  [[noreturn]] void end_and_fail(Fault fault, std::string_view detail);

  const std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  const AccelerometerSettings settings_;
  Session session_;
  Context context_;
  std::size_t chosen_ = 0;
  ScanLayout layout_;
  std::array<double, 3> scale_{};
  std::array<double, 3> offset_{};

  bool perhaps_open_ = false;
  bool running_ = false;
  std::size_t block_scans_ = 1;
  ReadingQueue readings_;
  std::uint64_t bad_blocks_ = 0;
  int lost_in_a_row_ = 0;
  std::uint64_t skipped_at_start_ = 0;
  std::optional<std::int64_t> last_time_ns_;
  std::vector<double> periods_s_;  ///< The first ones.
};

}  // namespace abcal::iio
