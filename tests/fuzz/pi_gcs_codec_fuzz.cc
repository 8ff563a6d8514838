// Fuzz target of the PI GCS codec: whatever the bytes, a reply ends where a slow reference ends it, and every
// form is recognised exactly where its grammar, walked character by character, recognises it, with the values
// of the C library.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// pi_gcs_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/pi_gcs/codec.h"

namespace {

namespace gcs = abcal::pi_gcs;
using Lines = std::vector<std::string>;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "PI GCS codec and reference differ: %s\n", what);
  std::abort();
}

std::string trimmed(std::string text) {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && blank(text.front())) text.erase(0, 1);
  while (!text.empty() && blank(text.back())) text.pop_back();
  return text;
}

std::string lowered(std::string text) {
  for (char& c : text)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c + 32);
  return text;
}

/// The text between separators.
Lines split(const std::string& text, char separator) {
  Lines parts(1);
  for (const char c : text) {
    if (c == separator) {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  return parts;
}

/// Digits of a base that are a number up to `most`.
std::optional<std::uint64_t> reference_digits(const std::string& text, unsigned base, std::uint64_t most) {
  static const std::string kDigits = "0123456789abcdef";
  if (text.empty()) return std::nullopt;
  std::uint64_t value = 0;
  for (const char c : lowered(text)) {
    const std::size_t digit = kDigits.find(c);
    if (digit >= base || value > (most - digit) / base) return std::nullopt;
    value = value * base + digit;
  }
  return value;
}

/// Digits in hexadecimal, with or without 0x.
std::optional<std::uint64_t> reference_hex(const std::string& text, std::uint64_t most) {
  return reference_digits(lowered(text).rfind("0x", 0) == 0 ? text.substr(2) : text, 16, most);
}

/// A sign, digits with a point somewhere, an exponent; and nothing that a double cannot tell from 0 or holds
/// only as infinite.
std::optional<double> reference_number(const std::string& untrimmed) {
  const std::string text = trimmed(untrimmed);
  std::size_t at = 0;
  const auto take = [&](std::string_view set) {
    const std::size_t begin = at;
    while (at < text.size() && set.find(text[at]) != std::string_view::npos) ++at;
    return text.substr(begin, at - begin);
  };
  constexpr std::string_view kDigits = "0123456789";
  if (take("+-").size() > 1) return std::nullopt;
  const std::string mantissa = take("0123456789.");
  const std::size_t point = mantissa.find('.');
  if (point != std::string::npos && mantissa.find('.', point + 1) != std::string::npos) return std::nullopt;
  if (mantissa.find_first_of(kDigits) == std::string::npos) return std::nullopt;
  if (const std::string exponent = take("eE"); !exponent.empty()) {
    if (exponent.size() > 1 || take("+-").size() > 1 || take(kDigits).empty()) return std::nullopt;
  }
  if (at != text.size()) return std::nullopt;
  const double value = std::strtod(text.c_str(), nullptr);
  if (!(std::abs(value) <= 1e12)) return std::nullopt;  // No number of a stage is larger.
  if (value == 0.0 && mantissa.find_first_of("123456789") != std::string::npos) return std::nullopt;
  return value;
}

bool same(std::optional<double> a, std::optional<double> b) {
  if (!a || !b) return a.has_value() == b.has_value();
  return *a == *b && std::signbit(*a) == std::signbit(*b);
}

/// Where the first reply ends: behind the first LF that has no space before it; 0 if there is none.
std::size_t reference_end(std::string_view bytes) {
  char before = '\n';
  for (std::size_t at = 0; at < bytes.size() && at < gcs::kLongestReply; ++at) {
    if (bytes[at] == '\n' && before != ' ') return at + 1;
    before = bytes[at];
  }
  return 0;
}

std::optional<Lines> reference_lines(std::string reply, const std::string& address) {
  if (!address.empty()) {
    const std::string prefix = "0 " + address + " ";
    if (reply.substr(0, prefix.size()) != prefix) return std::nullopt;
    reply.erase(0, prefix.size());
  }
  Lines lines = split(reply, '\n');
  if (lines.back().empty()) lines.pop_back();  // Nothing behind the last LF is no line.
  for (std::string& line : lines) line = trimmed(line);
  return lines;
}

/// Names and values, in order; nothing if there is a line of another form.
std::vector<std::pair<std::string, std::string>> reference_values(const Lines& lines) {
  std::vector<std::pair<std::string, std::string>> values;
  for (const std::string& line : lines) {
    const Lines parts = split(line, '=');
    const std::string name = trimmed(parts.front());
    if (parts.size() < 2 || name.empty()) return {};
    values.emplace_back(name, trimmed(line.substr(parts.front().size() + 1)));
  }
  return values;
}

void check_values(const Lines& lines) {
  const auto expected = reference_values(lines);
  const auto found = gcs::parse_axis_values(lines);
  require(found.has_value() == !expected.empty(), "whether these are values of axes");
  for (std::size_t i = 0; found && i < expected.size(); ++i) {
    require(found->size() == expected.size(), "how many values");
    require((*found)[i].axis == expected[i].first && (*found)[i].value == expected[i].second, "a value");
  }
  for (const std::string axis : {"1", "2", "1 14", "A", ""}) {
    std::optional<std::string> value;
    for (std::size_t i = expected.size(); i-- > 0;)
      if (expected[i].first == axis) value = expected[i].second;
    require(gcs::axis_value(lines, axis) == value, "value of an axis");
    require(same(gcs::axis_number(lines, axis), value ? reference_number(*value) : std::nullopt),
            "number of an axis");
    require(gcs::axis_flag(lines, axis) == (value == "0"   ? std::optional(false)
                                            : value == "1" ? std::optional(true)
                                                           : std::nullopt),
            "flag of an axis");
  }
  for (const unsigned parameter : {0x0EU, 0x0FU, 0x3FU, 0x406U}) {
    std::optional<double> value;
    for (std::size_t i = expected.size(); i-- > 0;) {
      const std::string name = split(expected[i].first, ' ').back();
      const auto number = lowered(name).rfind("0x", 0) == 0 ? reference_hex(name, 0xFFFFFFFF)
                                                            : reference_digits(name, 10, 0xFFFFFFFF);
      if (number == parameter) value = reference_number(expected[i].second);
    }
    require(same(gcs::parameter_number(lines, parameter), value), "parameter");
  }
}

void check_number(const std::string& text) {
  const auto number = gcs::parse_number(text);
  require(same(number, reference_number(text)), "number");
  if (!number || std::abs(*number) > 1e6) return;
  // The commanded number equals the parsed one, to half a millionth of a degree and the rounding of a double.
  const std::string move = gcs::move_command("1", abcal::Angle::degrees(*number));
  require(move.rfind("MOV 1 ", 0) == 0, "move");
  const auto target = reference_number(move.substr(6));
  const double rounding = 4.0 * std::numeric_limits<double>::epsilon() * std::abs(*number);
  require(target && std::abs(*target - *number) <= 0.5e-6 + rounding, "target of a move");
}

void check_status(const std::string& line) {
  const bool prefixed = lowered(line).rfind("0x", 0) == 0;
  const std::string digits = prefixed ? lowered(line).substr(2) : "";
  const bool is_one = !digits.empty() && digits.size() % 4 == 0 &&
                      digits.find_first_not_of("0123456789abcdef") == std::string::npos;
  const auto status = gcs::parse_status({line});
  require(status.has_value() == is_one, "whether it is a status");
  if (!status) return;
  require(status->size() == digits.size() / 4, "how many words of status");
  // A bit at a time, from the digit that holds it.
  for (std::size_t i = 0; i < status->size(); ++i) {
    const auto bit = [&](std::size_t digit, unsigned bit_of_digit) {
      return (reference_hex(digits.substr(4 * i + digit, 1), 15).value() >> bit_of_digit) % 2 == 1;
    };
    const gcs::AxisStatus& axis = (*status)[i];
    require(axis.negative_limit == bit(3, 0) && axis.positive_limit == bit(3, 2), "limits");
    require(axis.servo_on == bit(0, 0) && axis.moving == bit(0, 1) && axis.homing == bit(0, 2),
            "servo, motion, homing");
  }
}

void check_error(const std::string& line) {
  const bool negative = !line.empty() && line[0] == '-';
  const auto magnitude = reference_digits(negative ? line.substr(1) : line, 10, 2147483647U + negative);
  const auto code = gcs::parse_error_code({line});
  require(code.has_value() == magnitude.has_value(), "whether it is an error code");
  if (!code) return;
  const auto size = static_cast<std::int64_t>(*magnitude);
  require(*code == (negative ? -size : size), "error code");
  require(!gcs::error_text(*code).empty(), "words of an error");
}

void check_identity(const std::string& line) {
  const Lines parts = split(line, ',');
  const std::string model = parts.size() < 2 ? "" : trimmed(parts[1]);
  const bool is_one = lowered(parts[0]).find("physik instrumente") != std::string::npos && !model.empty();
  const auto identity = gcs::parse_identity({line});
  require(identity.has_value() == is_one, "whether it is an identity");
  if (!identity) return;
  require(trimmed(parts[0]).ends_with(identity->maker), "maker");
  require(lowered(identity->maker).find("physik instrumente") != std::string::npos, "name of the maker");
  require(identity->serial_number == (parts.size() >= 3 ? trimmed(parts[2]) : ""), "serial number");
  const std::size_t version = parts.size() == 2 ? lowered(model).find(" version ") : std::string::npos;
  require(identity->model == trimmed(model.substr(0, version)), "model");
  require(identity->firmware == (parts.size() >= 4              ? trimmed(parts[3])
                                 : version == std::string::npos ? ""
                                                                : trimmed(model.substr(version + 9))),
          "firmware");
}

void check_line(const std::string& line) {
  check_number(line);
  check_status(line);
  check_error(line);
  check_identity(line);
  require(gcs::parse_motion_mask({line}) == reference_hex(line, UINT64_MAX), "motion");
  const std::string unit = lowered(line);
  require(gcs::is_degrees(line) == (unit == "deg" || unit == "degree" || unit == "degrees" || unit == "\xB0"),
          "unit");
}

void check_help(const Lines& lines) {
  Lines expected;
  for (const std::string& line : lines) {
    const std::size_t begin = line.find_first_not_of(" \t");
    if (begin == std::string::npos) continue;
    const std::string word = line.substr(begin, line.find_first_of(" \t", begin) - begin);
    const std::string letters = word[0] == '#' || word[0] == '*' ? word.substr(1) : word;
    bool is_command = !letters.empty() && letters.size() <= 8;
    for (const char c : letters)
      is_command = is_command && ((c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '?');
    if (is_command) expected.push_back(word);
  }
  const bool is_list = std::count(expected.begin(), expected.end(), "MOV") > 0 &&
                       std::count(expected.begin(), expected.end(), "POS?") > 0;
  require(gcs::parse_help(lines) == (is_list ? std::optional(expected) : std::nullopt), "commands");
}

void check_reply(const std::string& reply) {
  for (const std::string address : {"", "2", "16"}) {
    const auto expected = reference_lines(reply, address);
    const auto lines = gcs::reply_lines(reply, address);
    require(lines == expected, "lines");
    if (!lines) continue;
    check_values(*lines);
    check_help(*lines);
    for (const std::string& line : *lines) check_line(line);
    if (lines->size() == 1) continue;
    require(!gcs::parse_error_code(*lines) && !gcs::parse_motion_mask(*lines) && !gcs::parse_status(*lines) &&
                !gcs::parse_identity(*lines),
            "one value of many lines");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  require(gcs::printable(rest).size() <= 4 * 80 + 3, "length of printable bytes");
  if (size > 0) {
    const auto ready = gcs::parse_ready(rest[0]);
    require(ready.has_value() == (data[0] == 0xB0 || data[0] == 0xB1), "whether it says if it is ready");
    if (ready) require(*ready == (data[0] == 0xB1), "ready");
  }
  while (!rest.empty()) {
    const auto verdict = gcs::check_reply(rest);
    const std::size_t end = reference_end(rest);
    if (end == 0) {
      require(verdict.check == (rest.size() < gcs::kLongestReply ? abcal::wire::FrameCheck::kNeedMore
                                                                 : abcal::wire::FrameCheck::kInvalid),
              "a reply that does not end");
      return 0;
    }
    require(verdict.check == abcal::wire::FrameCheck::kComplete && verdict.length == end, "reply");
    check_reply(std::string(rest.substr(0, end)));
    rest.remove_prefix(end);
  }
  return 0;
}
