// Fuzz target of the SCPI voltmeter codec: whatever the bytes, replies end where a slow reference says, every
// form is recognised exactly where its grammar, walked character by character, recognises it, its values are
// those of the C library, and no text has two forms.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// scpi_voltmeter_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
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

/// Walks through a text by the grammar of what it should be.
struct Walk {
  const std::string& text;
  std::size_t at = 0;

  bool done() const { return at == text.size(); }
  bool take(std::string_view word) {
    if (text.compare(at, word.size(), word) != 0) return false;
    at += word.size();
    return true;
  }
  /// All following characters of a set.
  std::string take_all(std::string_view set) {
    std::string taken;
    while (!done() && set.find(text[at]) != std::string_view::npos) taken += text[at++];
    return taken;
  }
  std::string take_digits() { return take_all("0123456789"); }
  bool take_minus() { return !take("+") && take("-"); }
};

std::string trimmed(std::string text) {
  while (!text.empty() && text.front() == ' ') text.erase(0, 1);
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text;
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

/// A number and its unit. False also if a double cannot tell it from 0.
bool reference_volts(const std::string& word, scpi::ChannelReading& reading) {
  Walk walk{word};
  walk.take_all(" ");
  const int sign = walk.take_minus() ? -1 : 1;
  const std::size_t begin = walk.at;
  std::string digits = walk.take_digits();
  if (walk.take(".")) digits += walk.take_digits();
  if (digits.empty()) return false;
  if (walk.take("e") || walk.take("E")) {
    walk.take_minus();
    if (walk.take_digits().empty()) return false;
  }
  const std::string number = word.substr(begin, walk.at - begin);
  walk.take_all(" ");
  if (walk.take("V")) walk.take("DC");
  walk.take_all(" ");
  if (!walk.done()) return false;

  const double value = std::strtod(number.c_str(), nullptr);
  if (value == 0.0 && digits.find_first_of("123456789") != std::string::npos) return false;
  if (value == 9.9e37) {
    reading = {0.0, sign, {}};
    return true;
  }
  if (value >= 1e30) return false;
  reading = {sign * value, 0, {}};
  return true;
}

bool reference_channel(Walk& walk, int& channel) {
  const std::string digits = walk.take_digits();
  channel = std::atoi(digits.c_str());
  return !digits.empty() && digits.size() <= 5;
}

bool reference_readings(const std::string& text, bool with_channels, std::vector<scpi::ChannelReading>& all) {
  const auto words = words_of(text);
  for (std::size_t i = 0; i < words.size(); ++i) {
    scpi::ChannelReading reading;
    if (!reference_volts(words[i], reading)) return false;
    if (with_channels) {
      if (++i == words.size()) return false;
      const std::string channel = trimmed(words[i]);
      Walk walk{channel};
      if (!reference_channel(walk, reading.channel.emplace())) return false;
      walk.take("INTCHAN");
      if (!walk.done()) return false;
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
  const auto words = words_of(text);
  std::string model = words.size() == 4 ? trimmed(words[1]) : "";
  std::string word = model.substr(0, 6);
  for (char& c : word) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  if (word == "MODEL ") model = trimmed(model.substr(6));
  const char first = words.size() == 4 && !trimmed(words[0]).empty() ? trimmed(words[0])[0] : '?';
  const bool is_one =
      printable(text) && !model.empty() && ((first >= 'A' && first <= 'Z') || (first >= 'a' && first <= 'z'));
  const auto found = scpi::parse_identity(text);
  require(found.has_value() == is_one, "whether it is an identity");
  if (!found) return 0;
  require(*found == scpi::Identity{trimmed(words[0]), model, trimmed(words[2]), trimmed(words[3])},
          "identity");
  return 1;
}

/// "-113,\"words\"".
bool reference_error(const std::string& text, scpi::ErrorReport& report) {
  Walk walk{text};
  const bool negative = walk.take_minus();
  const std::string digits = walk.take_digits();
  if (digits.empty() || !walk.take(",")) return false;
  walk.take_all(" ");
  if (!walk.take("\"")) return false;
  bool closed = false;
  while (!walk.done() && !closed) {
    if (walk.take("\"\"")) {
      report.words += '"';
    } else if (walk.take("\"")) {
      closed = true;
    } else {
      report.words += text[walk.at++];
    }
  }
  if (!closed || !walk.done()) return false;
  errno = 0;
  const long long code = std::strtoll(digits.c_str(), nullptr, 10);
  if (errno != 0 || code > 2147483647) return false;
  report.code = static_cast<int>(negative ? -code : code);
  return true;
}

int check_error(const std::string& text) {
  scpi::ErrorReport expected;
  const bool is_one = printable(text) && reference_error(text, expected);
  const auto found = scpi::parse_error(text);
  require(found.has_value() == is_one, "whether it is an error report");
  if (found) require(*found == expected, "error report");
  return found ? 1 : 0;
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

bool reference_channels(const std::string& text, std::vector<int>& channels) {
  Walk walk{text};
  if (!walk.take("(@")) return false;
  if (walk.take(")")) return walk.done();
  do {
    int first = 0;
    if (!reference_channel(walk, first)) return false;
    int last = first;
    if (walk.take(":") && !reference_channel(walk, last)) return false;
    if (last < first) return false;
    for (int channel = first; channel <= last; ++channel) {
      channels.push_back(channel);
      if (channels.size() > 1000) return false;
    }
  } while (walk.take(","));
  return walk.take(")") && walk.done();
}

int check_channels(const std::string& text) {
  std::vector<int> expected;
  const bool is_one = reference_channels(text, expected);
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
