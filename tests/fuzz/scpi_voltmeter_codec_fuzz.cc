// Fuzz target of the SCPI voltmeter codec: whatever the bytes, replies end where a slow reference says, every
// form is recognised exactly where regular expressions recognise it, its values are those of the C library,
// and no text has two forms.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// scpi_voltmeter_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <regex>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/scpi_voltmeter/codec.h"

namespace {

namespace scpi = abcal::scpi;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "SCPI codec and reference differ: %s\n", what);
  std::abort();
}

std::string trimmed(const std::string& text) {
  static const std::regex kEnds("^ +| +$");
  return std::regex_replace(text, kEnds, "");
}

std::vector<std::string> words_of(const std::string& text) {
  std::vector<std::string> words(1);
  for (const char c : text) {
    if (c == ',') {
      words.emplace_back();
    } else {
      words.back() += c;
    }
  }
  return words;
}

bool printable(const std::string& text) {
  for (const char c : text)
    if (c < ' ' || c > '~') return false;
  return true;
}

/// A number and its unit; nothing if the C library cannot hold it.
bool reference_volts(const std::string& word, scpi::ChannelReading& reading) {
  static const std::regex kShape("([+-]?)([0-9]+\\.?[0-9]*|\\.[0-9]+)([eE][+-]?[0-9]+)? *(VDC|V)?");
  const std::string text = trimmed(word);
  std::smatch parts;
  if (!std::regex_match(text, parts, kShape)) return false;
  const std::string digits = parts[2].str() + parts[3].str();
  const double value = std::strtod(digits.c_str(), nullptr);
  // A number that is too small to be told from 0 is refused.
  const bool is_zero = parts[2].str().find_first_of("123456789") == std::string::npos;
  if (value == 0.0 && !is_zero) return false;
  const int sign = parts[1] == "-" ? -1 : 1;
  if (value == 9.9e37) {
    reading = {0.0, sign, {}};
    return true;
  }
  if (value >= 1e30) return false;
  reading = {sign * value, 0, {}};
  return true;
}

bool reference_readings(const std::string& text, bool with_channels, std::vector<scpi::ChannelReading>& all) {
  static const std::regex kChannel(" *[0-9]{1,5} *");
  const auto words = words_of(text);
  for (std::size_t i = 0; i < words.size(); ++i) {
    scpi::ChannelReading reading;
    if (!reference_volts(words[i], reading)) return false;
    if (with_channels) {
      if (++i == words.size() || !std::regex_match(words[i], kChannel)) return false;
      reading.channel = std::atoi(words[i].c_str());
    }
    all.push_back(reading);
  }
  return true;
}

bool same(const std::vector<scpi::ChannelReading>& a, const std::vector<scpi::ChannelReading>& b) {
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (a[i].volts != b[i].volts || std::signbit(a[i].volts) != std::signbit(b[i].volts)) return false;
    if (a[i].overload != b[i].overload || a[i].channel != b[i].channel) return false;
    if (!std::isfinite(a[i].volts)) return false;
  }
  return true;
}

int check_readings(const std::string& text) {
  int forms = 0;
  for (const bool with_channels : {false, true}) {
    std::vector<scpi::ChannelReading> expected;
    const bool is_one = reference_readings(text, with_channels, expected);
    const auto found = scpi::parse_readings(text, with_channels);
    require(found.has_value() == is_one, "whether it is a list of readings");
    if (found) require(same(*found, expected), "readings");
    if (found) forms = 1;  // "1,2" may be either: which it is depends on what was set.
  }
  return forms;
}

int check_identity(const std::string& text) {
  static const std::regex kShape(" *[A-Za-z][^,]*, *[^, ][^,]*,[^,]*,[^,]*");
  const auto words = words_of(text);
  std::string model = words.size() == 4 ? trimmed(words[1]) : "";
  if (model.rfind("MODEL ", 0) == 0) model = trimmed(model.substr(6));
  const bool is_one = printable(text) && std::regex_match(text, kShape) && !model.empty();
  const auto found = scpi::parse_identity(text);
  require(found.has_value() == is_one, "whether it is an identity");
  if (!found) return 0;
  require(*found == scpi::Identity{trimmed(words[0]), model, trimmed(words[2]), trimmed(words[3])},
          "identity");
  return 1;
}

int check_error(const std::string& text) {
  static const std::regex kShape("([+-]?)([0-9]+), *\"((?:[^\"]|\"\")*)\" *");
  static const std::regex kTwice("\"\"");
  std::smatch parts;
  bool is_one = printable(text) && std::regex_match(text, parts, kShape);
  errno = 0;
  const long long code = is_one ? std::strtoll(parts[2].str().c_str(), nullptr, 10) : 0;
  is_one = is_one && errno == 0 && code <= 2147483647;
  const auto found = scpi::parse_error(text);
  require(found.has_value() == is_one, "whether it is an error report");
  if (!found) return 0;
  require(found->code == (parts[1] == "-" ? -code : code), "error code");
  require(found->words == std::regex_replace(parts[3].str(), kTwice, "\""), "error words");
  return 1;
}

int check_block(const std::string& text) {
  bool is_one = text.size() >= 2 && text[0] == '#' && text[1] >= '1' && text[1] <= '9';
  std::string inside;
  if (is_one) {
    const auto digits = static_cast<std::size_t>(text[1] - '0');
    is_one = text.size() >= 2 + digits &&
             text.substr(2, digits).find_first_not_of("0123456789") == std::string::npos &&
             std::stoull(text.substr(2, digits)) == text.size() - 2 - digits;
    if (is_one) inside = text.substr(2 + digits);
  }
  const auto found = scpi::parse_block(text);
  require(found.has_value() == is_one, "whether it is a block");
  if (!found) return 0;
  require(*found == inside, "block");
  return 1;
}

int check_channels(const std::string& text) {
  static const std::regex kShape("\\(@([0-9]{1,5}(:[0-9]{1,5})?(,[0-9]{1,5}(:[0-9]{1,5})?)*)?\\)");
  bool is_one = std::regex_match(text, kShape);
  std::vector<int> expected;
  if (is_one && text.size() > 3) {
    for (const std::string& word : words_of(text.substr(2, text.size() - 3))) {
      const int first = std::atoi(word.c_str());
      const std::size_t colon = word.find(':');
      const int last = colon == std::string::npos ? first : std::atoi(word.c_str() + colon + 1);
      is_one = is_one && last >= first;
      for (int channel = first; channel <= last && is_one; ++channel) {
        expected.push_back(channel);
        is_one = expected.size() <= 1000;
      }
    }
  }
  const auto found = scpi::parse_channel_list(text);
  require(found.has_value() == is_one, "whether it is a list of channels");
  if (!found) return 0;
  require(*found == expected, "channels");
  require(scpi::parse_channel_list(scpi::channel_list(expected)) == expected, "channels written");
  return 1;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  while (!rest.empty()) {
    const auto verdict = scpi::check_reply(rest);
    std::size_t end = 0;
    while (end < rest.size() && rest[end] != '\n') ++end;
    if (end == rest.size() || end >= scpi::kLongestReply) {
      require(verdict.check == (rest.size() < scpi::kLongestReply ? abcal::wire::FrameCheck::kNeedMore
                                                                  : abcal::wire::FrameCheck::kInvalid),
              "a reply that does not end");
      return 0;
    }
    require(verdict.check == abcal::wire::FrameCheck::kComplete && verdict.length == end + 1, "reply");
    std::string line(rest.substr(0, end));
    if (!line.empty() && line.back() == '\r') line.pop_back();
    const std::string text = trimmed(line);
    require(scpi::text_of(rest.substr(0, verdict.length)) == text, "text");
    const int forms = check_readings(text) + check_identity(text) + check_error(text) + check_block(text) +
                      check_channels(text);
    require(forms <= 1, "a text of two forms");
    rest.remove_prefix(verdict.length);
  }
  return 0;
}
