#include "drivers/text_line/environment.h"

#include <fmt/format.h>

#include <stdexcept>
#include <string_view>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::seconds;

// The air near a bench does not change within this time.
constexpr seconds kFresh{10};

text_line::LineFormat line_format(const EnvironmentSettings& settings) {
  text_line::LineFormat format{.columns = {}, .separator = settings.separator, .comment = settings.comment};
  for (const int column : {settings.temperature_column, settings.humidity_column, settings.pressure_column})
    if (column != 0) format.columns.push_back(column);
  return format;
}

}  // namespace

TextLineEnvironment::TextLineEnvironment(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                         const EnvironmentSettings& settings)
    : stream_(stream ? std::move(stream) : throw std::invalid_argument("TextLineEnvironment: no stream")),
      clock_(clock),
      instrument_(fmt::format("environment sensor text_line on {}", stream_->name())),
      reader_(line_format(settings)),
      dropped_(stream_->dropped_bytes()) {
  const auto add = [this](int column, const Quantity& quantity) {
    if (column != 0) quantities_.push_back(quantity);
  };
  add(settings.temperature_column,
      {"temperature", "degC", -90.0, 100.0, &EnvironmentReading::temperature_degc});
  add(settings.humidity_column,
      {"relative humidity", "%", 0.0, 100.0, &EnvironmentReading::humidity_percent});
  add(settings.pressure_column, {"pressure", "hPa", 300.0, 1200.0, &EnvironmentReading::pressure_hpa});
}

EnvironmentReading TextLineEnvironment::read(Clock::Instant deadline) {
  const Clock::Instant oldest = clock_.now() - kFresh;
  const std::uint64_t other_lines_before = reader_.header_lines() + reader_.bad_frames();
  std::optional<text_line::NumberLine> newest;
  std::string bytes;
  for (;;) {
    const wire::ReceivedBytes received = stream_->read_until(newest ? clock_.now() : deadline);
    if (received.bytes.empty()) break;
    bytes = received.bytes;
    const std::size_t dropped = stream_->dropped_bytes();
    const bool ran_over = std::exchange(dropped_, dropped) != dropped;
    if (ran_over) reader_.lose_track();  // The gap lies before these bytes or behind them.
    reader_.feed(received.bytes);
    while (auto line = reader_.next()) {
      has_any_come_ = true;
      if (received.arrival >= oldest) newest = std::move(line);
    }
    if (ran_over) reader_.lose_track();
    if (clock_.now() >= deadline) break;  // The stream may never pause.
  }
  if (!newest) fail_without_line(reader_.header_lines() + reader_.bad_frames() - other_lines_before, bytes);
  return checked(*newest);
}

/// `lines`: number of lines without numbers. `bytes`: the last received bytes.
void TextLineEnvironment::fail_without_line(std::uint64_t lines, const std::string& bytes) const {
  constexpr std::size_t kShownBytes = 32;
  const std::string shown = wire::bytes_as_text(std::string_view(bytes).substr(0, kShownBytes));
  if (lines == 0) {
    throw InstrumentError(instrument_, Fault::kNoReply,
                          bytes.empty()
                              ? std::string("not one byte arrived: is it switched on, and does it print "
                                            "without being asked, at least every few seconds?")
                              : fmt::format("no complete line arrived, only \"{}\"", shown));
  }
  throw InstrumentError(
      instrument_, has_any_come_ ? Fault::kBadFrame : Fault::kWrongIdentity,
      fmt::format("{} lines arrived without numbers in the columns of the bench file; the last bytes begin "
                  "\"{}\": check baud rate, columns, separator and comment mark",
                  lines, shown));
}

EnvironmentReading TextLineEnvironment::checked(const text_line::NumberLine& line) const {
  EnvironmentReading reading;
  for (std::size_t i = 0; i < quantities_.size(); ++i) {
    const Quantity& quantity = quantities_[i];
    const double value = line.values[i];
    if (!(value >= quantity.least && value <= quantity.most)) {
      throw InstrumentError(instrument_, Fault::kImplausible,
                            fmt::format("{} is {} {}; required: {} to {}; check its column and unit",
                                        quantity.name, value, quantity.unit, quantity.least, quantity.most));
    }
    reading.*quantity.where = value;
  }
  return reading;
}

}  // namespace abcal
