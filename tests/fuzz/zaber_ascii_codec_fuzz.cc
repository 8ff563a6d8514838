// Fuzz target of the Zaber ASCII codec: whatever the bytes, a message is given exactly where a slow reference
// (words and a sum) finds one, with the same parts.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// zaber_ascii_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/zaber_ascii/codec.h"

namespace {

namespace zaber = abcal::zaber_ascii;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "Zaber ASCII codec and reference differ: %s\n", what);
  std::abort();
}

bool one_of(const std::string& word, std::string_view first, std::string_view second) {
  return word == first || word == second;
}

bool is_number(const std::string& word, std::size_t digits) {
  return word.size() == digits && word.find_first_not_of("0123456789") == std::string::npos;
}

bool is_warning(const std::string& word) {
  return word == "--" ||
         (word.size() == 2 && word.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZ") == std::string::npos);
}

/// The words of a message without its checksum, in order: "@01", "2", "05", "OK", "BUSY", "WR", and all the
/// data. Words that its kind does not have are empty. Nothing if it is no message.
std::optional<std::vector<std::string>> reference_words(const std::string& content) {
  const char kind = content.empty() ? ' ' : content[0];
  if ((kind != '@' && kind != '#' && kind != '!') || content.back() == ' ') return std::nullopt;
  std::string rest = content + ' ';
  const auto take = [&rest] {
    const std::string word = rest.substr(0, rest.find(' '));
    rest.erase(0, word.size() + 1);
    return word;
  };
  std::vector<std::string> words(7);
  words[0] = take();
  words[1] = take();
  if (!is_number(words[0].substr(1), 2) || !is_number(words[1], 1)) return std::nullopt;
  if (kind != '!' && is_number(rest.substr(0, rest.find(' ')), 2)) words[2] = take();
  if (kind == '@' && !one_of(words[3] = take(), "OK", "RJ")) return std::nullopt;
  if (kind != '#' && !one_of(words[4] = take(), "IDLE", "BUSY")) return std::nullopt;
  if (kind != '#' && !is_warning(words[5] = take())) return std::nullopt;
  if (rest.empty() ? kind == '@' : rest[0] == ' ') return std::nullopt;
  words[6] = rest.substr(0, rest.empty() ? 0 : rest.size() - 1);
  return words;
}

void check_message(const std::string& line) {
  // The checksum: the sum of all that is between the first character and ':', and the two digits, is 0.
  std::string content = line;
  bool has_checksum = false;
  bool holds = true;
  if (line.size() >= 4 && line[line.size() - 3] == ':') {
    has_checksum = true;
    content.resize(line.size() - 3);
    unsigned sum = 0;
    for (std::size_t n = 1; n < content.size(); ++n) sum += static_cast<unsigned char>(content[n]);
    const std::string digits = line.substr(line.size() - 2);
    holds = digits.find_first_not_of("0123456789ABCDEF") == std::string::npos &&
            (sum + std::stoul(digits, nullptr, 16)) % 256 == 0;
  }
  bool printable = true;
  for (const char c : line) printable = printable && c >= ' ' && c <= '~';
  const bool continues = content.ends_with('\\');
  if (continues) content.pop_back();
  if (continues && content.ends_with(' ')) content.pop_back();
  const auto words = reference_words(content);
  const bool expected = printable && holds && words;
  const auto message = zaber::parse_message(line, false);
  require(message.has_value() == expected, "whether it is a message");
  require(zaber::parse_message(line, true).has_value() == (expected && has_checksum),
          "whether it is one with a checksum");
  if (!message) return;
  require(message->has_checksum == has_checksum && message->continues == continues, "checksum, continuation");
  const zaber::MessageKind kind = line[0] == '@'   ? zaber::MessageKind::kReply
                                  : line[0] == '#' ? zaber::MessageKind::kInfo
                                                   : zaber::MessageKind::kAlert;
  require(message->kind == kind, "kind");
  require(message->device == std::stoi(words->at(0).substr(1)) && message->axis == std::stoi(words->at(1)),
          "device, axis");
  const std::string& id = words->at(2);
  require(message->id == (id.empty() ? std::nullopt : std::optional(std::stoi(id))), "id");
  require(message->accepted == (words->at(3) == "OK") && message->busy == (words->at(4) == "BUSY"),
          "verdict, status");
  require(message->warning == words->at(5) && message->data == words->at(6), "warning, data");
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
