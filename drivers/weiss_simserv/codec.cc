#include "drivers/weiss_simserv/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

#include "drivers/text/names.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::weiss_simserv {
namespace {

bool is_name(std::string_view word) {
  return word.size() == 4 && (word.starts_with("CV") || word.starts_with("SV") || word.starts_with("MV")) &&
         std::all_of(word.begin() + 2, word.end(), [](char c) { return c >= '0' && c <= '9'; });
}

bool is_channel(std::string_view word) {
  return word.size() == 4 && word.starts_with("DO") && word[2] >= '0' && word[2] <= '9' && word[3] >= '0' &&
         word[3] <= '9';
}

std::optional<double> number_after(std::string_view line, std::string_view word) {
  const std::size_t at = line.find(word);
  if (at == std::string_view::npos) return std::nullopt;
  const std::vector<std::string_view> words = pieces::words(line.substr(at + word.size()));
  return words.empty() ? std::nullopt : parse_number(words[0]);
}

/// A line of the description of one value or channel: "CV01  value min:  -77.0   Value max:  182.0 ...".
void note_description(const std::string& line, Ascii2Layout& layout) {
  const std::vector<std::string_view> words = pieces::words(line);
  if (words.size() < 2) return;
  if (words[0] == "cv01" && line.find("min:") != std::string::npos) {
    layout.least_set_degc = number_after(line, "min:");
    layout.most_set_degc = number_after(line, "max:");
  }
  if (words[0].starts_with("cv") && words[0].size() == 4 && line.find("humid") != std::string::npos)
    layout.humidity = static_cast<std::size_t>((words[0][2] - '0') * 10 + (words[0][3] - '0'));
  if (words[0].starts_with("do") && words[0].size() == 4 && words[1] == "start")
    layout.start_channel = static_cast<std::size_t>((words[0][2] - '0') * 10 + (words[0][3] - '0'));
}

std::string decimal(double value) {
  return fmt::format("{:06.1f}", value);
}

}  // namespace

wire::FrameVerdict check_line(std::string_view bytes) {
  if (!bytes.empty() && bytes[0] == '\n') return {};
  const std::size_t end = bytes.find('\r');
  if (end == std::string_view::npos)
    return bytes.size() < kLongestLine ? wire::FrameVerdict{wire::FrameCheck::kNeedMore, 0}
                                       : wire::FrameVerdict{};
  if (end >= kLongestLine) return {};
  return {wire::FrameCheck::kComplete, end + 1};
}

std::string_view line_text(std::string_view frame) {
  while (frame.ends_with('\r') || frame.ends_with('\n')) frame.remove_suffix(1);
  return frame;
}

std::string simserv_request(int number, const std::vector<std::string>& arguments) {
  std::string line = fmt::format("{}{}1", number, kSeparator);
  for (const std::string& argument : arguments) line += kSeparator + argument;
  return line + '\r';
}

std::optional<SimservReply> parse_simserv(std::string_view line) {
  const std::vector<std::string_view> parts = pieces::split(line, kSeparator);
  const auto code = pieces::number<int>(parts.at(0));
  if (!code || (*code != 1 && *code >= 0)) return std::nullopt;
  SimservReply reply{*code, {}};
  for (std::size_t n = 1; n < parts.size(); ++n) reply.values.emplace_back(parts[n]);
  return reply;
}

constexpr auto kRefusals = names<int>({{-5, "it does not know the command"},
                                       {-6, "too few or wrong parameters"},
                                       {-8, "the data could not be read"}});

std::string_view refusal_text(int code) {
  return kRefusals.of(code, "a code that is not described");
}

std::optional<double> parse_number(std::string_view text) {
  text = pieces::trimmed(text);
  double sign = 1.0;
  // Zeros may precede the sign: "0-40.0".
  while (text.size() > 1 && text[0] == '0' && text[1] != '.') text.remove_prefix(1);
  if (text.starts_with('-') || text.starts_with('+')) {
    if (text[0] == '-') sign = -1.0;
    text.remove_prefix(1);
  }
  if (text.empty() || text[0] == '-' || text[0] == '+') return std::nullopt;
  const auto value = pieces::number<double>(text, std::chars_format::fixed);
  return value && std::isfinite(*value) ? std::optional(sign * *value) : std::nullopt;
}

std::optional<Ascii2Layout> parse_layout(std::string_view text) {
  Ascii2Layout layout;
  for (const std::string_view each : pieces::split(text, '\n')) {
    const std::string_view line = pieces::trimmed(each);
    const std::vector<std::string_view> words = pieces::words(line);
    const bool sets = words.size() > 1 && words[0].size() == 4 && words[0][0] == '$' && words[0][3] == 'E' &&
                      words[1] == "CV01";
    const bool tells = words.size() > 2 && words[0] == "CV01" && words[1] == "CV01";
    if (sets || tells) {
      std::vector<std::string>& order = sets ? layout.set_order : layout.state_order;
      if (!order.empty()) continue;
      std::size_t channels = 0;
      for (const std::string_view word : words) {
        if (is_name(word)) order.emplace_back(word);
        if (is_channel(word)) ++channels;
      }
      if (tells) layout.channels = channels;
      continue;
    }
    note_description(pieces::lower(line), layout);
  }
  if (layout.set_order.empty() || layout.state_order.empty()) return std::nullopt;
  return layout;
}

std::optional<Ascii2State> parse_state(std::string_view line) {
  std::vector<std::string_view> words = pieces::words(line);
  if (words.size() < 3) return std::nullopt;
  std::string_view channels = words.back();
  if (channels.ends_with('Z')) channels.remove_suffix(1);
  if (channels.size() < 2 || channels.find_first_not_of("01") != std::string_view::npos) return std::nullopt;
  words.pop_back();
  Ascii2State state;
  state.channels = channels;
  for (const std::string_view word : words) {
    const auto number = parse_number(word);
    if (!number) return std::nullopt;
    state.numbers.push_back(*number);
  }
  return state;
}

std::vector<double> values_of(const Ascii2Layout& layout, const Ascii2State& state, std::string_view name) {
  std::vector<double> values;
  for (std::size_t n = 0; n < layout.state_order.size() && n < state.numbers.size(); ++n)
    if (layout.state_order[n] == name) values.push_back(state.numbers[n]);
  return values;
}

std::string set_command(int address, const Ascii2Layout& layout, const Ascii2State& state, double degc,
                        const std::string& channels) {
  std::string line = fmt::format("${:02}E", address);
  for (const std::string& name : layout.set_order) {
    const std::vector<double> now = values_of(layout, state, name);
    double value = now.empty() || name.starts_with("MV") ? 0.0 : now.front();
    if (name == "CV01") value = degc;
    line += " " + decimal(value);
  }
  return line + " " + channels + "\r";
}

std::string slope_command(int address, double up, double down) {
  return fmt::format("${:02}U {} {} {} {}\r", address, decimal(up), decimal(down), decimal(0.0),
                     decimal(0.0));
}

std::string plain_command(int address, char what) {
  return fmt::format("${:02}{}\r", address, what);
}

}  // namespace abcal::weiss_simserv
