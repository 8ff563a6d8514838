#include "drivers/newport_esp/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::newport_esp {
namespace {

using pieces::trimmed;

// No angle, speed or count of a stage is this large: a larger number is a damaged reply.
constexpr double kLargestNumber = 1e12;

using Texts = std::pair<int, std::string_view>;

constexpr std::array kGeneralErrors = std::to_array<Texts>({
    {0, "no error"},
    {1, "PCI communication timeout"},
    {4, "emergency stop"},
    {6, "command does not exist"},
    {7, "parameter out of range"},
    {8, "cable interlock"},
    {9, "axis number out of range"},
    {13, "group error: number missing"},
    {14, "group error: number out of range"},
    {15, "group error: number not assigned"},
    {16, "group error: number already assigned"},
    {17, "group error: axis number out of range"},
    {18, "group error: axis number already assigned"},
    {19, "group error: axis number duplicated"},
    {20, "data acquisition is busy"},
    {21, "data acquisition setup error"},
    {22, "data acquisition not enabled"},
    {25, "download in progress"},
    {26, "program not started"},
    {27, "command not allowed now"},
    {28, "flash memory full"},
    {29, "group parameter missing"},
    {30, "group parameter out of range"},
    {31, "group velocity out of range"},
    {32, "group acceleration out of range"},
    {33, "group deceleration out of range"},
    {34, "move not allowed for the group"},
    {35, "program not found"},
    {37, "axis number missing"},
    {38, "parameter missing"},
    {39, "program label not found"},
    {40, "last command cannot be repeated"},
    {41, "too many program labels"},
});

constexpr std::array kAxisErrors = std::to_array<Texts>({
    {0, "motor type not defined"},
    {1, "parameter out of range"},
    {2, "amplifier fault"},
    {3, "following error"},
    {4, "positive hardware limit"},
    {5, "negative hardware limit"},
    {6, "positive software limit"},
    {7, "negative software limit"},
    {8, "stage not connected"},
    {9, "feedback signal fault"},
    {10, "maximum velocity exceeded"},
    {11, "maximum acceleration exceeded"},
    {13, "motor not enabled"},
    {15, "maximum jerk exceeded"},
    {16, "maximum DAC offset exceeded"},
    {17, "critical settings are protected"},
    {18, "ESP stage device error"},
    {19, "ESP stage data invalid"},
    {20, "homing aborted"},
    {21, "motor current not defined"},
    {22, "Unidrive communication error"},
    {23, "Unidrive not detected"},
    {24, "speed out of range"},
    {25, "invalid trajectory master axis"},
    {26, "parameter change not allowed while moving"},
    {27, "invalid trajectory mode for homing"},
    {28, "invalid encoder step ratio"},
    {29, "digital I/O interlock"},
    {30, "command not allowed during homing"},
    {31, "command not allowed for a group"},
    {32, "invalid trajectory mode for moving"},
});

template <std::size_t N>
std::string_view find_text(const std::array<Texts, N>& texts, int code) {
  for (const auto& [known, text] : texts) {
    if (known == code) return text;
  }
  return "unknown error";
}

constexpr std::array<std::string_view, 12> kUnits{
    "encoder counts", "motor steps", "mm", "um", "in", "mil", "uin", "deg", "gradian", "rad", "mrad", "urad"};

}  // namespace

std::string command_line(std::string_view text) {
  return fmt::format("{}\r", text);
}

std::string move_command(std::string_view axis, Angle target) {
  const double degrees = std::round(target.deg() * 1e6) / 1e6 + 0.0;  // + 0.0: never "-0.000000".
  return fmt::format("{}PA{:.6f}", axis, degrees);
}

wire::FrameVerdict check_reply(std::string_view bytes) {
  const std::size_t end = bytes.substr(0, kLongestReply).find_first_of("\r\n");
  if (end == std::string_view::npos) {
    return {bytes.size() < kLongestReply ? wire::FrameCheck::kNeedMore : wire::FrameCheck::kInvalid, 0};
  }
  const bool both = bytes[end] == '\r' && end + 1 < bytes.size() && bytes[end + 1] == '\n';
  return {wire::FrameCheck::kComplete, end + (both ? 2U : 1U)};
}

std::optional<std::string> line_text(std::string_view line) {
  const std::string_view text = trimmed(line);
  if (!std::all_of(text.begin(), text.end(), [](char c) { return c >= 0x20 && c < 0x7F; }))
    return std::nullopt;
  return std::string(text);
}

bool is_unsolicited(std::string_view text) {
  if (text.size() < 3 || text[0] != 'E' || (text.size() > 3 && text[3] >= '0' && text[3] <= '9'))
    return false;
  const auto code = pieces::number<int>(text.substr(1, 2));
  return code && *code >= 35 && *code <= 42;
}

std::optional<double> parse_number(std::string_view text) {
  const auto value = pieces::number<double>(pieces::without_plus(trimmed(text)));
  return value && std::abs(*value) <= kLargestNumber ? value : std::nullopt;
}

std::optional<bool> parse_flag(std::string_view text) {
  if (text == "1") return true;
  if (text == "0") return false;
  return std::nullopt;
}

std::optional<int> parse_unit(std::string_view text) {
  const auto unit = pieces::number<int>(text);
  if (!unit || *unit < 0 || *unit >= static_cast<int>(kUnits.size())) return std::nullopt;
  return unit;
}

std::string_view unit_name(int unit) {
  return unit >= 0 && unit < static_cast<int>(kUnits.size()) ? kUnits[static_cast<std::size_t>(unit)]
                                                             : "unknown unit";
}

std::optional<ErrorReport> parse_error_report(std::string_view text) {
  const std::size_t first = text.find(',');
  if (first == std::string_view::npos) return std::nullopt;
  const std::size_t second = text.find(',', first + 1);
  if (second == std::string_view::npos) return std::nullopt;
  const auto code = pieces::number<int>(trimmed(text.substr(0, first)));
  const auto stamp = pieces::number<std::uint64_t>(trimmed(text.substr(first + 1, second - first - 1)));
  const std::string_view words = trimmed(text.substr(second + 1));
  if (!code || *code < 0 || *code > 9999 || !stamp || words.empty()) return std::nullopt;
  return ErrorReport{*code, *stamp, std::string(words)};
}

std::string error_text(int code) {
  if (error_axis(code) == 0) return std::string(find_text(kGeneralErrors, code));
  return fmt::format("axis {}: {}", error_axis(code), find_text(kAxisErrors, code % 100));
}

std::optional<Identity> parse_identity(std::string_view text) {
  if (!text.starts_with("ESP30")) return std::nullopt;
  const std::size_t space = text.find(' ');
  Identity identity{std::string(text.substr(0, space)), {}};
  if (space == std::string_view::npos) return identity;
  std::string_view rest = trimmed(text.substr(space));
  constexpr std::string_view kVersion = "version ";
  const bool named = rest.size() > kVersion.size() &&
                     std::equal(kVersion.begin(), kVersion.end(), rest.begin(),
                                [](char wanted, char c) { return wanted == c || wanted == (c | 0x20); });
  if (named) rest.remove_prefix(kVersion.size());
  identity.firmware = trimmed(rest);
  return identity;
}

std::optional<StageIdentity> parse_stage_identity(std::string_view text) {
  if (text.empty()) return std::nullopt;
  const std::size_t comma = text.find(',');
  StageIdentity identity{std::string(trimmed(text.substr(0, comma))), {}};
  if (comma != std::string_view::npos) {
    std::string_view number = trimmed(text.substr(comma + 1));
    if (number.starts_with("SN") || number.starts_with("sn")) number.remove_prefix(2);
    identity.serial_number = trimmed(number);
  }
  return identity;
}

}  // namespace abcal::newport_esp
