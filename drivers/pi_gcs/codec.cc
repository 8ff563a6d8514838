#include "drivers/pi_gcs/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "drivers/text/names.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::pi_gcs {
namespace {

using pieces::lower;
using pieces::trimmed;

// No angle, speed or count of a stage is this large: a larger number is a damaged reply.
constexpr double kLargestNumber = 1e12;

std::string_view without_hex_prefix(std::string_view digits) {
  if (digits.starts_with("0x") || digits.starts_with("0X")) digits.remove_prefix(2);
  return digits;
}

/// PI_CNTR_... codes (PI, error codes of GCS 2.0; the texts are ours).
constexpr auto kErrorTexts = names<int>({
    {0, "no error"},
    {1, "syntax error in a parameter"},
    {2, "unknown command"},
    {3, "command too long"},
    {5, "move without a reference, or with the servo off"},
    {7, "position out of limits"},
    {8, "velocity out of limits"},
    {10, "stopped by command"},
    {15, "invalid axis identifier"},
    {16, "invalid stage name"},
    {17, "parameter out of range"},
    {22, "axis named twice"},
    {23, "illegal axis"},
    {24, "wrong number of parameters"},
    {25, "invalid number"},
    {26, "parameter missing"},
    {27, "soft limit out of range"},
    {31, "axis has no reference"},
    {32, "axis has no limit switch"},
    {34, "not allowed for this stage"},
    {39, "invalid controller number"},
    {45, "referencing failed"},
    {49, "move to the limit switch failed"},
    {50, "referencing is disabled for this axis"},
    {51, "axis is under joystick control"},
    {52, "communication error"},
    {53, "a dynamic move is in process"},
    {54, "unknown parameter"},
    {60, "parameter is protected"},
    {63, "initialisation is running"},
    {64, "parameter is read-only"},
    {66, "voltage out of limits"},
    {555, "internal error of the controller"},
    {1004, "unexpected response"},
    {-1, "communication error in the host"},
    {-7, "timeout in the host"},
});

}  // namespace

std::string command_line(std::string_view text, std::string_view address) {
  return address.empty() ? fmt::format("{}\n", text) : fmt::format("{} {}\n", address, text);
}

std::string single_byte(char code, std::string_view address) {
  return address.empty() ? std::string(1, code) : fmt::format("{} {}\n", address, code);
}

std::string move_command(std::string_view axis, Angle target) {
  const double degrees = std::round(target.deg() * 1e6) / 1e6 + 0.0;  // + 0.0: never "-0.000000".
  return fmt::format("MOV {} {:.6f}", axis, degrees);
}

wire::FrameVerdict check_reply(std::string_view bytes) {
  const std::string_view shown = bytes.substr(0, kLongestReply);
  for (std::size_t at = shown.find('\n'); at != std::string_view::npos; at = shown.find('\n', at + 1)) {
    if (at == 0 || shown[at - 1] != ' ') return {wire::FrameCheck::kComplete, at + 1};
  }
  return {bytes.size() < kLongestReply ? wire::FrameCheck::kNeedMore : wire::FrameCheck::kInvalid, 0};
}

std::optional<std::vector<std::string>> reply_lines(std::string_view reply, std::string_view address) {
  if (!address.empty()) {
    const std::string prefix = fmt::format("0 {} ", address);
    if (!reply.starts_with(prefix)) return std::nullopt;
    reply.remove_prefix(prefix.size());
  }
  std::vector<std::string> lines;
  while (!reply.empty()) {
    const std::size_t end = reply.find('\n');
    lines.emplace_back(trimmed(reply.substr(0, end)));
    if (end == std::string_view::npos) break;
    reply.remove_prefix(end + 1);
  }
  return lines;
}

std::optional<std::vector<AxisValue>> parse_axis_values(const std::vector<std::string>& lines) {
  std::vector<AxisValue> values;
  for (const std::string& line : lines) {
    const std::size_t equals = line.find('=');
    if (equals == std::string::npos) return std::nullopt;
    const std::string_view text(line);
    values.push_back(
        {std::string(trimmed(text.substr(0, equals))), std::string(trimmed(text.substr(equals + 1)))});
    if (values.back().axis.empty()) return std::nullopt;
  }
  if (values.empty()) return std::nullopt;
  return values;
}

std::optional<std::string> axis_value(const std::vector<std::string>& lines, std::string_view axis) {
  const auto values = parse_axis_values(lines);
  if (!values) return std::nullopt;
  for (const AxisValue& entry : *values) {
    if (entry.axis == axis) return entry.value;
  }
  return std::nullopt;
}

std::optional<double> axis_number(const std::vector<std::string>& lines, std::string_view axis) {
  const auto value = axis_value(lines, axis);
  return value ? parse_number(*value) : std::nullopt;
}

std::optional<bool> axis_flag(const std::vector<std::string>& lines, std::string_view axis) {
  const auto value = axis_value(lines, axis);
  if (value == "1") return true;
  if (value == "0") return false;
  return std::nullopt;
}

std::optional<std::string> parameter_text(const std::vector<std::string>& lines, unsigned parameter) {
  const auto values = parse_axis_values(lines);
  if (!values) return std::nullopt;
  for (const AxisValue& entry : *values) {
    const std::size_t space = entry.axis.rfind(' ');
    const std::string_view name = space == std::string::npos ? std::string_view(entry.axis)
                                                             : std::string_view(entry.axis).substr(space + 1);
    const std::string_view digits = without_hex_prefix(name);
    if (pieces::number<unsigned>(digits, digits.size() == name.size() ? 10 : 16) == parameter) {
      return entry.value;
    }
  }
  return std::nullopt;
}

std::optional<double> parameter_number(const std::vector<std::string>& lines, unsigned parameter) {
  const auto value = parameter_text(lines, parameter);
  return value ? parse_number(*value) : std::nullopt;
}

std::optional<double> parse_number(std::string_view text) {
  const auto value = pieces::number<double>(pieces::without_plus(trimmed(text)));
  return value && std::abs(*value) <= kLargestNumber ? value : std::nullopt;
}

std::optional<int> parse_error_code(const std::vector<std::string>& lines) {
  if (lines.size() != 1) return std::nullopt;
  return pieces::number<int>(lines.front());
}

std::optional<std::vector<std::string>> parse_help(const std::vector<std::string>& lines) {
  std::vector<std::string> commands;
  for (const std::string& line : lines) {
    const std::vector<std::string_view> words = pieces::words(line, " \t");
    if (words.empty()) continue;
    std::string_view word = words.front();
    const std::string_view letters = word.front() == '#' || word.front() == '*' ? word.substr(1) : word;
    const bool is_command =
        letters.size() <= 8 &&
        letters.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789?") == letters.npos;
    if (is_command && !letters.empty()) commands.emplace_back(word);
  }
  // One that is a list of commands has these.
  for (const std::string_view must : {"MOV", "POS?"})
    if (std::find(commands.begin(), commands.end(), must) == commands.end()) return std::nullopt;
  return commands;
}

std::optional<std::uint64_t> parse_motion_mask(const std::vector<std::string>& lines) {
  if (lines.size() != 1) return std::nullopt;
  return pieces::number<std::uint64_t>(without_hex_prefix(lines.front()), 16);
}

std::optional<std::vector<AxisStatus>> parse_status(const std::vector<std::string>& lines) {
  if (lines.size() != 1 || !lower(lines.front()).starts_with("0x")) return std::nullopt;
  const std::string_view digits = without_hex_prefix(lines.front());
  if (digits.empty() || digits.size() % 4 != 0) return std::nullopt;
  std::vector<AxisStatus> axes;
  for (std::size_t at = 0; at < digits.size(); at += 4) {
    const auto word = pieces::number<std::uint16_t>(digits.substr(at, 4), 16);
    if (!word) return std::nullopt;
    const auto bit = [&word](unsigned mask) { return (*word & mask) != 0; };
    axes.push_back({bit(0x0001), bit(0x0004), bit(0x1000), bit(0x2000), bit(0x4000)});
  }
  return axes;
}

std::optional<bool> parse_ready(char reply) {
  switch (static_cast<unsigned char>(reply)) {
    case 0xB1:
      return true;
    case 0xB0:
      return false;
    default:
      return std::nullopt;
  }
}

std::optional<Identity> parse_identity(const std::vector<std::string>& lines) {
  if (lines.size() != 1) return std::nullopt;
  // "(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 123456, 1.2.3", or older
  // "(c)2013 Physik Instrumente(PI) Karlsruhe, E-861 Version 7.2.0".
  std::vector<std::string> parts;
  for (std::string_view rest = lines.front();;) {
    const std::size_t comma = rest.find(',');
    parts.emplace_back(trimmed(rest.substr(0, comma)));
    if (comma == std::string_view::npos) break;
    rest.remove_prefix(comma + 1);
  }
  const std::size_t maker = lower(parts[0]).find("physik instrumente");
  if (maker == std::string::npos || parts.size() < 2 || parts[1].empty()) return std::nullopt;
  Identity identity;
  identity.maker = parts[0].substr(maker);
  identity.model = parts[1];
  if (parts.size() >= 3) identity.serial_number = parts[2];
  if (parts.size() >= 4) identity.firmware = parts[3];
  const std::size_t version = lower(identity.model).find(" version ");
  if (parts.size() == 2 && version != std::string::npos) {
    identity.firmware = trimmed(std::string_view(identity.model).substr(version + 9));
    identity.model = trimmed(std::string_view(identity.model).substr(0, version));
  }
  return identity;
}

bool is_degrees(std::string_view unit) {
  const std::string name = lower(trimmed(unit));
  // 0xB0 is the degree sign in cp1252, the controllers' encoding.
  return name == "deg" || name == "degree" || name == "degrees" || name == "\xB0";
}

std::string_view error_text(int code) {
  return kErrorTexts.of(code, "unknown error");
}

}  // namespace abcal::pi_gcs
