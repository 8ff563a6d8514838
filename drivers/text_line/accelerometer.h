#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/text_line/codec.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/reading_stream.h"

namespace abcal {

/// Any board that prints an accelerometer's three outputs as lines of text. Nothing is ever sent to it.
///
/// An output is (number - bias) / scale, in AccelerometerSettings::unit. "nan" and "inf" on a line are
/// delivered unchanged: the reading was made, but its value is not a number.
///
/// Lines have no counter: readings whose line was damaged are counted as lost, those that vanish without
/// leaving a byte behind cannot be counted, and a late line does not count as a loss (wire::ReadingStream).
/// Nor is there a checksum: a damaged digit that is still a digit is not noticed.
class TextLineAccelerometer final : public Accelerometer {
 public:
  /// @throws std::invalid_argument for invalid settings, or if stream is null.
  TextLineAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                        const AccelerometerSettings& settings);

  /// Listens until two lines in a row have numbers in the columns, and as many columns. The board does not
  /// identify itself: maker, model and firmware are "unknown", the serial number is empty. A started stream
  /// must be started again.
  /// @throws InstrumentError kNoReply, kWrongIdentity (no such lines), each quoting what was received;
  /// kImplausible if the separator looks like the decimal mark of the numbers.
  AccelerometerInfo identify() override;

  /// Identifies, and waits until it is seen to print about rate_hz lines a second. From here on each line
  /// must have as many columns.
  /// @throws InstrumentError kImplausible if it prints another number of lines.
  void start() override;

  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override;
  StreamHealth health() const override { return readings_.health(); }
  /// Stops listening. The board prints on.
  void stop() noexcept override { readings_.end(); }

 private:
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;
  [[noreturn]] void fail_without_lines(Clock::Duration waited) const;
  AccelerometerInfo interrogate();
  Reading reading_of(const text_line::NumberLine& line);

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  AccelerometerSettings settings_;
  std::string instrument_;  ///< For messages.
  text_line::LineFormat format_;
  wire::ReadingStream<text_line::LineReader> readings_;
  std::size_t words_ = 0;        ///< Columns of the last line.
  unsigned like_lines_ = 0;      ///< Lines in a row that had as many.
  bool decimal_commas_ = false;  ///< The last line looked so.
};

}  // namespace abcal
