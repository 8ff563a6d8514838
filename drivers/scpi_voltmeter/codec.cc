#include "drivers/scpi_voltmeter/codec.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "drivers/text/text.h"

namespace abcal::scpi {
namespace {

constexpr double kOverload = 9.9e37;
constexpr double kNoVoltage = 1e30;  // Only SCPI's special values have this magnitude.
constexpr std::size_t kMostChannels = 1000;

using pieces::is_digit;
using pieces::split;

bool is_letter(char c) {
  return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z');
}

bool is_printable(std::string_view text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; });
}

std::string_view trim(std::string_view text) {
  return pieces::trimmed(text, " ");
}

/// Takes a sign off the front, because std::from_chars accepts only a minus. Absent if the rest begins with
/// another sign.
std::optional<bool> take_sign(std::string_view& text) {
  const bool negative = text.starts_with('-');
  if (negative || text.starts_with('+')) text.remove_prefix(1);
  if (text.starts_with('-') || text.starts_with('+')) return std::nullopt;
  return negative;
}

std::optional<int> parse_channel(std::string_view text) {
  if (text.empty() || text.size() > 5 || !std::all_of(text.begin(), text.end(), is_digit))
    return std::nullopt;
  int channel = 0;
  for (const char c : text) channel = 10 * channel + (c - '0');
  return channel;
}

std::optional<ChannelReading> parse_volts(std::string_view text) {
  const auto negative = take_sign(text);
  // Otherwise std::from_chars would accept "inf" and "nan".
  if (!negative || text.empty() || (!is_digit(text.front()) && text.front() != '.')) return std::nullopt;
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{}) return std::nullopt;
  const std::string_view unit = trim({end, static_cast<std::size_t>(text.data() + text.size() - end)});
  if (!unit.empty() && unit != "VDC" && unit != "V") return std::nullopt;
  const int sign = *negative ? -1 : 1;
  if (value == kOverload) return ChannelReading{0.0, sign, std::nullopt};
  if (!(value < kNoVoltage)) return std::nullopt;
  return ChannelReading{sign * value, 0, std::nullopt};
}

}  // namespace

wire::FrameVerdict check_reply(std::string_view bytes) {
  const std::size_t end = bytes.substr(0, kLongestReply).find('\n');
  if (end != std::string_view::npos) return {wire::FrameCheck::kComplete, end + 1};
  return {bytes.size() < kLongestReply ? wire::FrameCheck::kNeedMore : wire::FrameCheck::kInvalid, 0};
}

std::string_view text_of(std::string_view reply) {
  if (reply.ends_with('\n')) reply.remove_suffix(1);
  if (reply.ends_with('\r')) reply.remove_suffix(1);
  return trim(reply);
}

std::optional<Identity> parse_identity(std::string_view text) {
  if (!is_printable(text)) return std::nullopt;
  const std::vector<std::string_view> words = split(text, ',');
  if (words.size() != 4) return std::nullopt;
  Identity identity{std::string(trim(words[0])), std::string(trim(words[1])), std::string(trim(words[2])),
                    std::string(trim(words[3]))};
  constexpr std::string_view kModel = "MODEL ";  // In any case.
  const auto is_same = [](char a, char b) { return a == (b >= 'a' && b <= 'z' ? b - 'a' + 'A' : b); };
  if (identity.model.size() > kModel.size() &&
      std::equal(kModel.begin(), kModel.end(), identity.model.begin(), is_same))
    identity.model = trim(identity.model.substr(kModel.size()));
  if (identity.maker.empty() || !is_letter(identity.maker.front()) || identity.model.empty())
    return std::nullopt;
  return identity;
}

std::optional<ErrorReport> parse_error(std::string_view text) {
  if (!is_printable(text)) return std::nullopt;
  const auto negative = take_sign(text);
  if (!negative) return std::nullopt;
  ErrorReport report;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), report.code);
  if (error != std::errc{}) return std::nullopt;
  if (*negative) report.code = -report.code;
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  if (!text.starts_with(',')) return std::nullopt;
  text = trim(text.substr(1));
  if (text.size() < 2 || text.front() != '"' || text.back() != '"') return std::nullopt;
  text = text.substr(1, text.size() - 2);
  for (std::size_t at = 0; at < text.size(); ++at) {  // A quotation mark inside is doubled.
    if (text[at] == '"' && (++at == text.size() || text[at] != '"')) return std::nullopt;
    report.words += text[at];
  }
  return report;
}

std::optional<std::vector<ChannelReading>> parse_readings(std::string_view text, bool with_channels) {
  const std::vector<std::string_view> words = split(text, ',');
  const std::size_t step = with_channels ? 2 : 1;
  if (words.size() % step != 0) return std::nullopt;
  std::vector<ChannelReading> readings;
  for (std::size_t i = 0; i < words.size(); i += step) {
    auto reading = parse_volts(trim(words[i]));
    if (!reading) return std::nullopt;
    if (with_channels) {
      constexpr std::string_view kInternal = "INTCHAN";  // Internal channel of a Keithley 2001.
      std::string_view channel = trim(words[i + 1]);
      if (channel.ends_with(kInternal)) channel.remove_suffix(kInternal.size());
      reading->channel = parse_channel(channel);
      if (!reading->channel) return std::nullopt;
    }
    readings.push_back(*reading);
  }
  return readings;
}

std::optional<std::string_view> parse_block(std::string_view text) {
  if (text.size() < 2 || text[0] != '#' || text[1] < '1' || text[1] > '9') return std::nullopt;
  const auto digits = static_cast<std::size_t>(text[1] - '0');
  if (text.size() < 2 + digits) return std::nullopt;
  std::size_t length = 0;
  for (const char c : text.substr(2, digits)) {
    if (!is_digit(c)) return std::nullopt;
    length = 10 * length + static_cast<std::size_t>(c - '0');
  }
  if (text.size() != 2 + digits + length) return std::nullopt;
  return text.substr(2 + digits);
}

std::string channel_list(std::span<const int> channels) {
  return fmt::format("(@{})", fmt::join(channels, ","));
}

std::optional<std::vector<int>> parse_channel_list(std::string_view text) {
  if (!text.starts_with("(@") || !text.ends_with(')')) return std::nullopt;
  text = text.substr(2, text.size() - 3);
  std::vector<int> channels;
  if (text.empty()) return channels;
  for (const std::string_view word : split(text, ',')) {
    const std::size_t colon = word.find(':');
    const auto first = parse_channel(word.substr(0, colon));
    const auto last = colon == std::string_view::npos ? first : parse_channel(word.substr(colon + 1));
    if (!first || !last || *last < *first) return std::nullopt;
    if (channels.size() + static_cast<std::size_t>(*last - *first) >= kMostChannels) return std::nullopt;
    for (int channel = *first; channel <= *last; ++channel) channels.push_back(channel);
  }
  return channels;
}

}  // namespace abcal::scpi
