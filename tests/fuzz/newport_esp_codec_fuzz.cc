// Fuzz target of the Newport ESP codec: whatever the bytes, lines end where a slow reference ends them, and
// every value that is given is one that the text shows when it is read another way.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// newport_esp_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <regex>
#include <string>
#include <string_view>

#include "drivers/newport_esp/codec.h"

namespace {

namespace esp = abcal::newport_esp;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "Newport ESP codec and reference differ: %s\n", what);
  std::abort();
}

bool matches(const std::string& text, const std::regex& pattern) {
  return std::regex_match(text, pattern);
}

/// Regular expressions are the slow reference.
void decode_all(const std::string& text) {
  static const std::regex kNumber("[ \\t]*[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?[ \\t]*");
  static const std::regex kFlag("[01]");
  static const std::regex kReport("[ \\t]*([0-9]+|-0+)[ \\t]*,[ \\t]*([0-9]+)[ \\t]*,[ \\t]*(.*)");
  static const std::regex kPlainNumber("[ \\t]*[+]?[0-9.]+[ \\t]*");
  static const std::regex kUnsolicited("E(3[5-9]|4[0-2])([^0-9].*)?");
  const auto number = esp::parse_number(text);
  if (number) {
    require(std::isfinite(*number), "a number that is not finite");
    require(matches(text, kNumber), "number");
    require(std::strtod(text.c_str() + text.find_first_not_of(" \t+"), nullptr) == *number,
            "value of a number");
  }
  require(esp::parse_flag(text).has_value() == matches(text, kFlag), "flag");
  if (const auto unit = esp::parse_unit(text)) require(*unit >= 0 && *unit <= 11, "unit");
  if (const auto report = esp::parse_error_report(text)) {
    std::smatch parts;
    require(std::regex_match(text, parts, kReport), "error report");
    require(std::stoi(parts[1]) == report->code && std::stoull(parts[2]) == report->time_stamp,
            "values of the error report");
    require(!report->text.empty(), "text of the error report");
    require(!esp::error_text(report->code).empty(), "words of an error");
    require(!matches(text, kPlainNumber), "an error report that is a number as well");
  }
  if (const auto identity = esp::parse_identity(text)) {
    require(text.starts_with("ESP30") && identity->model.find(' ') == std::string::npos, "identity");
    require(!esp::parse_error_report(text) || text.find(',') != std::string::npos,
            "identity and error report");
  }
  if (const auto stage = esp::parse_stage_identity(text))
    require(
        text.find(stage->model) != std::string::npos && text.find(stage->serial_number) != std::string::npos,
        "stage identity");
  require(esp::is_unsolicited(text) == matches(text, kUnsolicited), "unsolicited line");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  require(esp::printable(rest).size() <= 4 * 80 + 3, "length of printable bytes");
  while (!rest.empty()) {
    const auto verdict = esp::check_reply(rest);
    std::size_t end = 0;
    while (end < rest.size() && rest[end] != '\r' && rest[end] != '\n') ++end;
    if (end == rest.size() || end >= esp::kLongestReply) {
      require(verdict.check == (rest.size() < esp::kLongestReply ? abcal::wire::FrameCheck::kNeedMore
                                                                 : abcal::wire::FrameCheck::kInvalid),
              "a line that does not end");
      return 0;
    }
    const bool both = rest.substr(end).starts_with("\r\n");
    require(verdict.check == abcal::wire::FrameCheck::kComplete && verdict.length == end + (both ? 2 : 1),
            "line");
    if (const auto text = esp::line_text(rest.substr(0, verdict.length))) {
      for (const char c : *text) require(c >= ' ' && c <= '~', "a byte that cannot be printed");
      decode_all(*text);
    }
    rest.remove_prefix(verdict.length);
  }
  return 0;
}
