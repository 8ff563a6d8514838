#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "sim/firmware/firmware.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

struct TextLineSettings {
  enum class Content {
    kAcceleration,  ///< u, v, w: scale * output + bias.
    kEnvironment,   ///< Temperature in degC, relative humidity in percent, pressure in hPa.
  };
  Content content = Content::kAcceleration;
  double rate_hz = 100.0;
  std::array<double, 3> scale{1.0, 1.0, 1.0};
  std::array<double, 3> bias{0.0, 0.0, 0.0};
  int decimals = 6;
  std::string separator = ",";
  /// In front of the numbers, "ax ay az": a line is an object of JSON where the decimal mark is a point, else
  /// "ax=0,1 ay=0,2 az=0,3". Empty: numbers alone.
  std::string names;
  std::string number_unit;         ///< Behind each number at once.
  std::string decimal_mark = ".";  ///< Numbers are quoted if this equals the separator.
  std::string header;              ///< A line that is printed once, at power on; empty: none.
  bool time_column = false;        ///< A first column: milliseconds since power on.
  bool crlf = true;                ///< False: lines end with LF.
  double humidity_percent = 45.0;
  double pressure_hpa = 1013.25;
  std::optional<unsigned> baud{};  ///< Speed of its serial line, Bd; absent: USB, which has no speed.
};

/// A board with a user's own program that prints numbers as lines of text, reading the world of a SimBench.
/// Powered on at the start of the world's time; receives nothing. Values that are not finite are printed as
/// "nan".
class TextLineFirmware final : public Firmware {
 public:
  /// @throws std::invalid_argument unless rate_hz is positive and at most 1e4, and decimals 0 to 17.
  explicit TextLineFirmware(std::shared_ptr<SimBench> bench, TextLineSettings settings = {});

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override { return settings_.baud; }

 private:
  Clock::Instant line_time(std::uint64_t index) const;
  std::array<double, 3> numbers(std::uint64_t index) const;
  std::string line(std::uint64_t index) const;
  std::string word(double number) const;

  std::shared_ptr<SimBench> bench_;
  TextLineSettings settings_;
  bool header_is_due_;
  std::uint64_t next_index_ = 0;
};

}  // namespace abcal::sim
