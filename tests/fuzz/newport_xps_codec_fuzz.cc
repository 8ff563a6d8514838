// Fuzz target of the XPS codec: whatever the bytes, replies end where a slow reference ends them, and every
// value that is given is one that regular expressions and strtod read from the same text.

#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>

#include "drivers/newport_xps/codec.h"

namespace {

namespace xps = abcal::newport_xps;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "XPS codec and reference differ: %s\n", what);
  std::abort();
}

/// A number in C's notation that begins with a digit, a point or a minus sign.
bool is_number(const std::string& text, double& value, bool& too_small) {
  if (text.empty() || text.find_first_not_of("0123456789.-+eE") != std::string::npos) return false;
  if (text[0] == '+') return false;
  char* end = nullptr;
  errno = 0;
  value = std::strtod(text.c_str(), &end);
  too_small = errno == ERANGE && std::abs(value) < 1.0;
  return *end == '\0' && std::isfinite(value) && std::abs(value) <= 1e12;
}

void decode(const std::string& body) {
  const auto reply = xps::parse_reply(body + std::string(xps::kReplyEnd));
  if (!reply) return;
  const std::size_t comma = body.find(',');
  require(std::to_string(reply->code) == body.substr(0, comma) || body[0] == '0' || body[1] == '0', "code");
  require(std::atoi(body.c_str()) == reply->code, "value of the code");
  require(reply->values == (comma == std::string::npos ? "" : body.substr(comma + 1)), "values");
  for (const char c : reply->values) require(c >= ' ' && c <= '~', "a byte that cannot be printed");
  double value = 0.0;
  bool too_small = false;  // Too small for a double: refused, 0, or the denormal rest.
  const auto number = xps::parse_number(reply->values);
  const bool expected = is_number(reply->values, value, too_small);
  require(number.has_value() == expected || too_small, "number");
  if (number) require(*number == value, "value of a number");
  std::size_t count = 1;
  for (const char c : reply->values) count += c == ',' ? 1U : 0U;
  if (const auto numbers = xps::parse_numbers(reply->values, count))
    require(numbers->size() == count, "count of numbers");
  require(!xps::parse_numbers(reply->values, count + 1), "one number too many");
  if (const auto state = xps::parse_state(reply->values)) {
    require(*state == std::atoi(reply->values.c_str()) && *state >= 0 && *state <= 127, "state");
    require(!xps::state_text(*state).empty(), "words of a state");
  }
  if (const auto identity = xps::parse_identity(reply->values))
    require(reply->values.starts_with(identity->model) &&
                reply->values.find(identity->firmware) != std::string::npos,
            "identity");
  require(!xps::error_text(reply->code).empty(), "words of an error");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view rest(reinterpret_cast<const char*>(data), size);
  for (;;) {
    const auto verdict = xps::check_reply(rest);
    const std::size_t end = rest.find(",EndOfAPI");
    const bool there = end != std::string_view::npos && end + 9 <= xps::kLongestReply;
    require((verdict.check == abcal::wire::FrameCheck::kComplete) == there, "end of a reply");
    if (!there) {
      require(verdict.length == 0 &&
                  (verdict.check == abcal::wire::FrameCheck::kInvalid) == (rest.size() >= xps::kLongestReply),
              "a reply that does not end");
      return 0;
    }
    require(verdict.length == end + 9, "length of a reply");
    decode(std::string(rest.substr(0, end)));
    rest.remove_prefix(verdict.length);
  }
}
