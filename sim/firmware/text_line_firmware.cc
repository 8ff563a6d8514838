#include "sim/firmware/text_line_firmware.h"

#include <fmt/format.h>

#include <chrono>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/text.h"

namespace abcal::sim {

TextLineFirmware::TextLineFirmware(std::shared_ptr<SimBench> bench, TextLineSettings settings)
    : bench_(std::move(bench)), settings_(std::move(settings)), header_is_due_(!settings_.header.empty()) {
  if (!(settings_.rate_hz > 0.0 && settings_.rate_hz <= 1e4)) {
    throw std::invalid_argument(
        fmt::format("simulated board: rate_hz is {}, required: above 0, at most 1e4", settings_.rate_hz));
  }
  if (settings_.decimals < 0 || settings_.decimals > 17) {
    throw std::invalid_argument(
        fmt::format("simulated board: decimals is {}, required: 0 to 17", settings_.decimals));
  }
}

void TextLineFirmware::receive(std::string_view /*bytes*/, Clock::Instant /*now*/) {}

std::string TextLineFirmware::transmit(Clock::Instant now) {
  std::string out;
  if (header_is_due_ && bench_->start() <= now) {
    header_is_due_ = false;
    out = settings_.header + (settings_.crlf ? "\r\n" : "\n");
  }
  for (; line_time(next_index_) <= now; ++next_index_)
    if (!bench_->fault_at(FaultKind::kNoOutput, line_time(next_index_))) out += line(next_index_);
  return out;
}

void TextLineFirmware::power(bool on, Clock::Instant now) {
  if (!on) return;
  header_is_due_ = !settings_.header.empty();
  while (line_time(next_index_) <= now) ++next_index_;
}

std::optional<Clock::Instant> TextLineFirmware::next_due() const {
  return header_is_due_ ? bench_->start() : line_time(next_index_);
}

/// The first line is printed a period after power on.
Clock::Instant TextLineFirmware::line_time(std::uint64_t index) const {
  return bench_->start() + from_seconds(static_cast<double>(index + 1) / settings_.rate_hz);
}

std::array<double, 3> TextLineFirmware::numbers(std::uint64_t index) const {
  const SimOutput output = bench_->output(line_time(index), index, from_seconds(1.0 / settings_.rate_hz));
  if (settings_.content == TextLineSettings::Content::kEnvironment)
    return {output.temperature_degc, settings_.humidity_percent, settings_.pressure_hpa};
  std::array<double, 3> printed{};
  for (std::size_t i = 0; i < 3; ++i)
    printed[i] = settings_.scale[i] * output.value(static_cast<Eigen::Index>(i)) + settings_.bias[i];
  return printed;
}

std::string TextLineFirmware::word(double number) const {
  std::string text = fmt::format("{:.{}f}", number, settings_.decimals);
  if (const std::size_t point = text.find('.'); point != std::string::npos)
    text.replace(point, 1, settings_.decimal_mark);
  text += settings_.number_unit;
  const bool needs_quotes = settings_.names.empty() && settings_.decimal_mark == settings_.separator;
  return needs_quotes ? "\"" + text + "\"" : text;
}

std::string TextLineFirmware::line(std::uint64_t index) const {
  using Milliseconds = std::chrono::milliseconds;
  std::string text;
  if (settings_.time_column) {
    const auto since = std::chrono::floor<Milliseconds>(line_time(index) - bench_->start());
    text = fmt::format("{}{}", since.count(), settings_.separator);
  }
  const auto [first, second, third] = numbers(index);
  const std::vector<std::string_view> names = pieces::words(settings_.names);
  if (names.size() != 3) {
    text += fmt::format("{}{}{}{}{}", word(first), settings_.separator, word(second), settings_.separator,
                        word(third));
  } else if (settings_.decimal_mark == ".") {
    const char* quote = settings_.number_unit.empty() ? "" : "\"";
    text += fmt::format("{{\"{1}\":{0}{2}{0},\"{3}\":{0}{4}{0},\"{5}\":{0}{6}{0}}}", quote, names[0],
                        word(first), names[1], word(second), names[2], word(third));
  } else {
    text += fmt::format("{}={} {}={} {}={}", names[0], word(first), names[1], word(second), names[2],
                        word(third));
  }
  return text + (settings_.crlf ? "\r\n" : "\n");
}

}  // namespace abcal::sim
