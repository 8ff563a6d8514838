#include "drivers/text_line/accelerometer.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/text/text.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::seconds;
using text_line::LineReader;

// Many boards restart when their port is opened, and wait 2 s for a new program before they run theirs
// [unverified against a device].
constexpr seconds kFirstLineTime{5};
constexpr unsigned kLikeLines = 2;

// A board's loop that waits between its lines prints fewer of them than it was meant to.
constexpr double kRateTolerance = 0.2;

constexpr std::string_view kUnknown = "unknown";

std::vector<std::string> names_of(const AccelerometerSettings& settings) {
  const std::vector<std::string_view> words = pieces::words(settings.names);
  if (!words.empty() && words.size() != 3) {
    throw std::invalid_argument(
        fmt::format("TextLineAccelerometer: names \"{}\"; required: those of u, v, w, with blanks between",
                    settings.names));
  }
  return {words.begin(), words.end()};
}

char decimal_mark_of(const AccelerometerSettings& settings) {
  if (settings.decimal_mark.size() == 1) return settings.decimal_mark.front();
  throw std::invalid_argument(
      fmt::format("TextLineAccelerometer: decimal_mark \"{}\"; required: . or ,", settings.decimal_mark));
}

AccelerometerSettings checked(AccelerometerSettings settings) {
  if (!(settings.rate_hz > 0.0) || !std::isfinite(settings.rate_hz)) {
    throw std::invalid_argument(
        fmt::format("TextLineAccelerometer: rate_hz is {}; required: a positive number", settings.rate_hz));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (settings.scale[i] != 0.0 && std::isfinite(settings.scale[i]) && std::isfinite(settings.bias[i]))
      continue;
    throw std::invalid_argument(
        fmt::format("TextLineAccelerometer: scale {}, bias {}; required: finite numbers, and no scale of 0",
                    settings.scale[i], settings.bias[i]));
  }
  if (settings.unit.empty()) settings.unit = "R";
  return settings;
}

}  // namespace

TextLineAccelerometer::TextLineAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                             const AccelerometerSettings& settings)
    : stream_(stream ? std::move(stream) : throw std::invalid_argument("TextLineAccelerometer: no stream")),
      clock_(clock),
      settings_(checked(settings)),
      instrument_(fmt::format("accelerometer text_line on {}", stream_->name())),
      format_{.columns = {settings.columns.begin(), settings.columns.end()},
              .separator = settings.separator,
              .comment = settings.comment,
              .names = names_of(settings),
              .unit = settings.number_unit,
              .decimal_mark = decimal_mark_of(settings)},
      readings_(*stream_, LineReader(format_), [this](const text_line::NumberLine& line) {
        return wire::DecodedFrame{.reading = reading_of(line)};
      }) {}

AccelerometerInfo TextLineAccelerometer::identify() {
  return interrogate();
}

void TextLineAccelerometer::start() {
  interrogate();
  readings_.parser().require_words(words_);
  const Clock::Duration span = from_seconds(std::max(1.0, 2.0 / settings_.rate_hz));
  const auto measured_hz = readings_.measure_rate_hz(span, clock_.now() + 3 * span);
  if (!measured_hz || std::abs(*measured_hz / settings_.rate_hz - 1.0) > kRateTolerance) {
    const std::string found = measured_hz
                                  ? fmt::format("{:.3g} a second", *measured_hz)
                                  : fmt::format("less than three within {:.1f} s", to_seconds(3 * span));
    fail(Fault::kImplausible,
         fmt::format("rate_hz is {:.6g}, but the lines that arrived were {}: set rate_hz to the rate at "
                     "which it prints, or raise its baud rate if that limits it",
                     settings_.rate_hz, found));
  }
  readings_.start();
}

std::optional<Reading> TextLineAccelerometer::next(Clock::Instant deadline) {
  if (!readings_.running()) fail(Fault::kNotReady, "asked for a reading before it was started");
  return readings_.next(deadline);
}

void TextLineAccelerometer::discard_pending() {
  if (readings_.running()) readings_.discard_pending(clock_.now());
}

void TextLineAccelerometer::fail(Fault fault, std::string_view detail) const {
  throw InstrumentError(instrument_, fault, detail);
}

void TextLineAccelerometer::fail_without_lines(Clock::Duration waited) const {
  if (readings_.received_bytes() == 0) {
    fail(
        Fault::kNoReply,
        fmt::format(
            "not one byte arrived within {:.1f} s: is it switched on, and does it print without being asked?",
            to_seconds(waited)));
  }
  const std::string wanted =
      format_.names.empty()
          ? fmt::format(
                "lines in a row with numbers in columns {} separated by \"{}\" and with equal numbers of "
                "columns",
                fmt::join(format_.columns, ", "), wire::bytes_as_text(format_.separator))
          : fmt::format("readings with a number behind each of the names {}", fmt::join(format_.names, ", "));
  fail(Fault::kWrongIdentity,
       fmt::format("{} bytes arrived within {:.1f} s, but not {} {}; beginning \"{}\": another instrument is "
                   "on this port, or its baud rate, {} or comment mark differ from the bench file",
                   readings_.received_bytes(), to_seconds(waited), kLikeLines, wanted,
                   wire::bytes_as_text(readings_.first_bytes()),
                   format_.names.empty() ? "columns, separator" : "names, decimal mark, unit"));
}

AccelerometerInfo TextLineAccelerometer::interrogate() {
  like_lines_ = 0;
  readings_.listen(LineReader(format_));
  stream_->discard_input();
  const Clock::Instant began = clock_.now();
  const Clock::Instant deadline = began + kFirstLineTime + from_seconds((kLikeLines + 1) / settings_.rate_hz);
  // The stream may never pause.
  while (like_lines_ < kLikeLines && readings_.receive(deadline) && clock_.now() < deadline) continue;
  if (like_lines_ < kLikeLines) fail_without_lines(clock_.now() - began);
  if (decimal_commas_) {
    fail(Fault::kImplausible,
         fmt::format("the separator \",\" seems to be the decimal mark of its numbers, beginning \"{}\": let "
                     "the board print numbers with a decimal point, or use another separator",
                     wire::bytes_as_text(readings_.first_bytes())));
  }
  return AccelerometerInfo{
      .maker = std::string(kUnknown),
      .model = std::string(kUnknown),
      .serial_number = "",
      .firmware = std::string(kUnknown),
      .output_unit = settings_.unit,
      .full_scale = settings_.full_scale,
      .resolution = std::nullopt,
      .rate_hz = settings_.rate_hz,
  };
}

Reading TextLineAccelerometer::reading_of(const text_line::NumberLine& line) {
  like_lines_ = line.words == words_ ? like_lines_ + 1 : 1;
  words_ = line.words;
  decimal_commas_ = line.decimal_commas;
  Reading reading;
  for (std::size_t i = 0; i < 3; ++i)
    reading.output(static_cast<Eigen::Index>(i)) = (line.values[i] - settings_.bias[i]) / settings_.scale[i];
  return reading;
}

}  // namespace abcal
