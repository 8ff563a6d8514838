// Fuzz target of the Zaber ASCII codec: whatever the bytes, a message is given exactly where a slow reference
// (a regular expression and a sum) finds one, with the same parts.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// zaber_ascii_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <regex>
#include <string>
#include <string_view>

#include "drivers/zaber_ascii/codec.h"

namespace {

namespace zaber = abcal::zaber_ascii;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "Zaber ASCII codec and reference differ: %s\n", what);
  std::abort();
}

void check_message(const std::string& line) {
  static const std::regex kShape(
      "(@)([0-9]{2}) ([0-9])( [0-9]{2})? (OK|RJ) (IDLE|BUSY) (--|[A-Z]{2}) ([^ ].*)|"
      "(#)([0-9]{2}) ([0-9])( [0-9]{2})?( [^ ].*)?|"
      "(!)([0-9]{2}) ([0-9]) (IDLE|BUSY) (--|[A-Z]{2})( [^ ].*)?");
  // The checksum: the sum of all that is between the first character and ':', and the two digits, is 0.
  std::string content = line;
  bool has_checksum = false;
  bool holds = true;
  if (line.size() >= 4 && line[line.size() - 3] == ':') {
    has_checksum = true;
    content.resize(line.size() - 3);
    unsigned sum = 0;
    for (std::size_t n = 1; n < content.size(); ++n) sum += static_cast<unsigned char>(content[n]);
    static const std::regex kDigits("[0-9A-F]{2}");
    const std::string digits = line.substr(line.size() - 2);
    holds = std::regex_match(digits, kDigits) && (sum + std::stoul(digits, nullptr, 16)) % 256 == 0;
  }
  bool printable = true;
  for (const char c : line) printable = printable && c >= ' ' && c <= '~';
  const bool continues = content.ends_with('\\');
  if (continues) content.pop_back();
  if (continues && content.ends_with(' ')) content.pop_back();
  std::smatch parts;
  const bool shaped = std::regex_match(content, parts, kShape) && !content.ends_with(' ');
  const bool expected = printable && holds && shaped;
  const auto message = zaber::parse_message(line, false);
  require(message.has_value() == expected, "whether it is a message");
  require(zaber::parse_message(line, true).has_value() == (expected && has_checksum),
          "whether it is one with a checksum");
  if (!message) return;
  require(message->has_checksum == has_checksum && message->continues == continues, "checksum, continuation");
  if (parts[1].matched) {
    require(message->kind == zaber::MessageKind::kReply, "kind");
    require(message->device == std::stoi(parts[2]) && message->axis == std::stoi(parts[3]), "device, axis");
    require(
        message->id.has_value() == parts[4].matched && (!message->id || *message->id == std::stoi(parts[4])),
        "id");
    require(message->accepted == (parts[5] == "OK") && message->busy == (parts[6] == "BUSY"),
            "verdict, status");
    require(message->warning == parts[7] && message->data == parts[8], "warning, data");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  require(zaber::printable(rest).size() <= 4 * 80 + 3, "length of printable bytes");
  while (!rest.empty()) {
    const auto verdict = zaber::check_line(rest);
    std::size_t end = 0;
    while (end < rest.size() && rest[end] != '\r' && rest[end] != '\n') ++end;
    if (end == rest.size() || end >= zaber::kLongestLine) {
      require(verdict.check == (rest.size() < zaber::kLongestLine ? abcal::wire::FrameCheck::kNeedMore
                                                                  : abcal::wire::FrameCheck::kInvalid),
              "a line that does not end");
      return 0;
    }
    const bool both = rest.substr(end).starts_with("\r\n");
    require(verdict.check == abcal::wire::FrameCheck::kComplete && verdict.length == end + (both ? 2 : 1),
            "line");
    const std::string line(rest.substr(0, end));
    check_message(line);
    if (const auto found = zaber::find_message(rest.substr(0, verdict.length), false)) {
      require(zaber::parse_message(line, false) || found->has_checksum, "a message behind garbage");
      if (const auto flags = zaber::parse_warnings(found->data))
        for (const std::string& flag : *flags) require(flag.size() == 2, "warning flag");
      const std::string word = found->data.substr(0, found->data.find(' '));
      if (const auto number = zaber::parse_number(word))
        require(std::isfinite(*number) && std::strtod(word.c_str(), nullptr) == *number, "number");
    }
    rest.remove_prefix(verdict.length);
  }
  return 0;
}
