#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/environment_sensor.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/text_line/codec.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// Any thermometer, hygrometer or barometer that prints its numbers as lines of text. Nothing is ever sent to
/// it.
class TextLineEnvironment final : public EnvironmentSensor {
 public:
  /// @throws std::invalid_argument for invalid settings, or if stream is null.
  TextLineEnvironment(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                      const EnvironmentSettings& settings);

  /// The newest whole line that waits, or the next one if that arrived more than 10 s ago. A sensor that
  /// prints every t seconds needs a deadline 2 t away for its first line, as half a line does not count.
  /// @throws InstrumentError kNoReply (no whole line), kWrongIdentity (lines, and never one with numbers in
  /// the columns), kBadFrame (only damaged lines); kImplausible if a number is not finite, or outside -90 to
  /// 100 degC, 0 to 100 %, 300 to 1200 hPa.
  EnvironmentReading read(Clock::Instant deadline) override;

 private:
  /// One number of the line and its permitted range.
  struct Quantity {
    const char* name;
    const char* unit;
    double least;
    double most;
    std::optional<double> EnvironmentReading::*where;
  };

  [[noreturn]] void fail_without_line(std::uint64_t lines, const std::string& bytes) const;
  EnvironmentReading checked(const text_line::NumberLine& line) const;

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  std::string instrument_;            ///< For messages.
  std::vector<Quantity> quantities_;  ///< In the order of the columns that are read.
  text_line::LineReader reader_;
  std::size_t dropped_ = 0;  ///< Bytes dropped by the stream.
  bool has_any_come_ = false;
};

}  // namespace abcal
