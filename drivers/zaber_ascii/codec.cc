#include "drivers/zaber_ascii/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "drivers/text/names.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::zaber_ascii {
namespace {

using pieces::is_digit;

/// Takes the next word off the front: words are separated by single spaces.
std::string_view take_word(std::string_view& rest) {
  const std::size_t space = rest.find(' ');
  const std::string_view word = rest.substr(0, space);
  rest.remove_prefix(space == std::string_view::npos ? rest.size() : space + 1);
  return word;
}

std::optional<int> fixed_digits(std::string_view word, std::size_t count) {
  if (word.size() != count || !std::all_of(word.begin(), word.end(), is_digit)) return std::nullopt;
  int value = 0;
  for (const char c : word) value = 10 * value + (c - '0');
  return value;
}

std::optional<unsigned> hex_digit(char c) {
  if (is_digit(c)) return static_cast<unsigned>(c - '0');
  if (c >= 'A' && c <= 'F') return static_cast<unsigned>(c - 'A') + 10U;
  return std::nullopt;
}

bool is_flag(std::string_view word) {
  return word == "--" || (word.size() == 2 &&
                          std::all_of(word.begin(), word.end(), [](char c) { return c >= 'A' && c <= 'Z'; }));
}

constexpr auto kWarnings = names<std::string_view>({
    {"--", "no warning"},
    {"FD", "driver overheated or disabled"},
    {"FQ", "encoder error"},
    {"FS", "stalled and stopped"},
    {"FT", "lockstep axes twisted"},
    {"FB", "stream bounds exceeded"},
    {"FP", "path deviation too large"},
    {"FE", "limit sensor error"},
    {"WH", "not homed"},
    {"WL", "unexpected limit sensor"},
    {"WP", "calibration of another type than the stage"},
    {"WV", "supply voltage out of range"},
    {"WT", "temperature too high"},
    {"WM", "displaced while it stood still"},
    {"WR", "no reference position"},
    {"NC", "moved by its knob"},
    {"NI", "its motion was interrupted by another command"},
    {"ND", "stream discontinuity"},
    {"NU", "a setting is pending"},
    {"NJ", "joystick is being calibrated"},
});

constexpr auto kRejections = names<std::string_view>({
    {"AGAIN", "it cannot be done now; try again"},
    {"BADAXIS", "there is no such axis"},
    {"BADCOMMAND", "the device does not know the command"},
    {"BADDATA", "a number is out of range or of another kind"},
    {"BADMESSAGEID", "the message id is wrong"},
    {"DEVICEONLY", "it is for the whole device, not for an axis"},
    {"DRIVERDISABLED", "the driver of the axis is disabled"},
    {"FULL", "no memory is left"},
    {"INACTIVE", "the axis is not active"},
    {"LOCKSTEP", "the axis moves in lockstep with another"},
    {"NOACCESS", "access is not permitted"},
    {"PARKED", "the axis is parked"},
    {"STATUSBUSY", "it is not permitted while the axis moves"},
});

}  // namespace

std::uint8_t checksum(std::string_view content) {
  unsigned sum = 0;
  for (const char c : content) sum += static_cast<unsigned char>(c);
  return static_cast<std::uint8_t>(0U - sum);
}

std::string command_line(std::string_view content) {
  return fmt::format("/{}:{:02X}\n", content, checksum(content));
}

std::string command(int device, int axis, int id, std::string_view data) {
  return command_line(data.empty() ? fmt::format("{} {} {}", device, axis, id)
                                   : fmt::format("{} {} {} {}", device, axis, id, data));
}

wire::FrameVerdict check_line(std::string_view bytes) {
  const std::string_view shown = bytes.substr(0, kLongestLine);
  const std::size_t end = shown.find_first_of("\r\n");
  if (end == std::string_view::npos) {
    return {bytes.size() < kLongestLine ? wire::FrameCheck::kNeedMore : wire::FrameCheck::kInvalid, 0};
  }
  const bool both = shown[end] == '\r' && end + 1 < bytes.size() && bytes[end + 1] == '\n';
  return {wire::FrameCheck::kComplete, end + (both ? 2U : 1U)};
}

std::optional<Message> parse_message(std::string_view line, bool checksum_required) {
  Message message;
  if (line.empty()) return std::nullopt;
  switch (line[0]) {
    case '@':
      message.kind = MessageKind::kReply;
      break;
    case '#':
      message.kind = MessageKind::kInfo;
      break;
    case '!':
      message.kind = MessageKind::kAlert;
      break;
    default:
      return std::nullopt;
  }
  line.remove_prefix(1);
  if (!std::all_of(line.begin(), line.end(), [](char c) { return c >= 0x20 && c < 0x7F; }))
    return std::nullopt;
  if (line.size() >= 3 && line[line.size() - 3] == ':') {
    const auto high = hex_digit(line[line.size() - 2]);
    const auto low = hex_digit(line[line.size() - 1]);
    line.remove_suffix(3);
    if (!high || !low || 16U * *high + *low != checksum(line)) return std::nullopt;
    message.has_checksum = true;
  }
  if (checksum_required && !message.has_checksum) return std::nullopt;
  if (line.ends_with('\\')) {
    message.continues = true;
    line.remove_suffix(1);
    if (line.ends_with(' ')) line.remove_suffix(1);
  }
  if (line.ends_with(' ')) return std::nullopt;

  std::string_view rest = line;
  const auto device = fixed_digits(take_word(rest), 2);
  const auto axis = fixed_digits(take_word(rest), 1);
  if (!device || !axis) return std::nullopt;
  message.device = *device;
  message.axis = *axis;
  if (message.kind != MessageKind::kAlert) {
    std::string_view after = rest;
    if (const auto id = fixed_digits(take_word(after), 2)) {
      message.id = id;
      rest = after;
    }
  }
  if (message.kind == MessageKind::kReply) {
    const std::string_view verdict = take_word(rest);
    if (verdict != "OK" && verdict != "RJ") return std::nullopt;
    message.accepted = verdict == "OK";
  }
  if (message.kind != MessageKind::kInfo) {
    const std::string_view status = take_word(rest);
    if (status != "IDLE" && status != "BUSY") return std::nullopt;
    message.busy = status == "BUSY";
    message.warning = take_word(rest);
    if (!is_flag(message.warning)) return std::nullopt;
  }
  if (rest.starts_with(' ') || (message.kind == MessageKind::kReply && rest.empty())) return std::nullopt;
  message.data = rest;
  return message;
}

std::optional<Message> find_message(std::string_view line, bool checksum_required) {
  while (line.ends_with('\n') || line.ends_with('\r')) line.remove_suffix(1);
  if (auto message = parse_message(line, checksum_required)) return message;
  for (std::size_t at = line.find_first_of("@#!", 1); at != std::string_view::npos;
       at = line.find_first_of("@#!", at + 1)) {
    if (auto message = parse_message(line.substr(at), true)) return message;
  }
  return std::nullopt;
}

std::optional<double> parse_number(std::string_view text) {
  // No position, speed or setting is this large: a larger number is a damaged reply.
  constexpr double kLargestNumber = 1e18;
  const auto value = pieces::number<double>(text);
  return value && std::abs(*value) <= kLargestNumber ? value : std::nullopt;
}

std::optional<std::vector<std::string>> parse_warnings(std::string_view data) {
  std::string_view rest = data;
  const auto count = fixed_digits(take_word(rest), 2);
  if (!count) return std::nullopt;
  std::vector<std::string> flags;
  while (!rest.empty()) {
    flags.emplace_back(take_word(rest));
    if (!is_flag(flags.back())) return std::nullopt;
  }
  if (flags.size() != static_cast<std::size_t>(*count)) return std::nullopt;
  return flags;
}

std::string_view warning_text(std::string_view flag) {
  return kWarnings.of(flag, "of unknown meaning");
}

std::string_view rejection_text(std::string_view reason) {
  return kRejections.of(reason, "of unknown meaning");
}

}  // namespace abcal::zaber_ascii
