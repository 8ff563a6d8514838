// Fuzz target of the codec of the Weiss chambers: whatever the bytes, lines, numbers and replies are those
// that a slow reference (streams and words) finds.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <sstream>
#include <string>
#include <vector>

#include "drivers/weiss_simserv/codec.h"

namespace {

namespace weiss = abcal::weiss_simserv;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "codec of Weiss chambers and reference differ: %s\n", what);
  std::abort();
}

void check_line(const std::string& line) {
  if (const auto reply = weiss::parse_simserv(line)) {
    std::vector<std::string> parts{""};
    for (const char c : line) {
      if (c == weiss::kSeparator) {
        parts.emplace_back();
      } else {
        parts.back() += c;
      }
    }
    require(std::to_string(reply->code) == parts[0] || std::atoi(parts[0].c_str()) == reply->code, "code");
    require(reply->code == 1 || reply->code < 0, "a code that cannot be");
    require(reply->values == std::vector<std::string>(parts.begin() + 1, parts.end()), "values");
  }
  if (const auto number = weiss::parse_number(line)) require(std::isfinite(*number), "a number that is none");
  if (const auto state = weiss::parse_state(line)) {
    std::istringstream words(line);
    std::size_t count = 0;
    for (std::string word; words >> word;) ++count;
    require(state->numbers.size() + 1 == count, "how many numbers");
    require(state->channels.find_first_not_of("01") == std::string::npos, "channels");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  std::string rest = text;
  while (!rest.empty()) {
    const auto verdict = weiss::check_line(rest);
    const std::size_t end = rest.find('\r');
    const bool whole = rest[0] != '\n' && end != std::string::npos && end < weiss::kLongestLine;
    require((verdict.check == abcal::wire::FrameCheck::kComplete) == whole, "whether it is a line");
    if (verdict.check == abcal::wire::FrameCheck::kNeedMore) break;
    if (!whole) {
      rest.erase(0, 1);
      continue;
    }
    require(verdict.length == end + 1, "length of a line");
    check_line(std::string(weiss::line_text(rest.substr(0, verdict.length))));
    rest.erase(0, verdict.length);
  }
  if (const auto layout = weiss::parse_layout(text)) {
    require(!layout->set_order.empty() && !layout->state_order.empty(), "an empty layout");
    if (layout->least_set_degc) require(std::isfinite(*layout->least_set_degc), "a limit that is none");
  }
  return 0;
}
