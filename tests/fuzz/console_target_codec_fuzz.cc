// Fuzz target of the targets of HTTP requests: whatever the bytes, they are parsed or refused; the parsed
// text has exactly the letters that were sent, and writing and reading it again changes nothing.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// console_target_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>

#include "app/console/target.h"

namespace {

using abcal::console::parse_form;
using abcal::console::parse_target;
using abcal::console::Target;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "the target of a request: %s\n", what);
  std::abort();
}

bool is_printable(char c) {
  return c > ' ' && c < 0x7f;
}

/// Every byte as an escape: a decoder has nothing to guess.
std::string escaped(std::string_view word) {
  constexpr std::string_view kDigits = "0123456789ABCDEF";
  std::string text;
  for (const char c : word) {
    const auto byte = static_cast<unsigned char>(c);
    text += '%';
    text += kDigits[byte / 16U];
    text += kDigits[byte % 16U];
  }
  return text;
}

std::string written(const Target& target) {
  std::string text;
  for (const std::string& word : target.words) text += "/" + escaped(word);
  if (text.empty()) text = "/";
  return text;
}

}  // namespace

/// The fields of a form, read again when they are written out, are the same.
void read_form(std::string_view text) {
  const auto fields = parse_form(text);
  if (!fields) return;
  std::string again;
  for (const auto& [name, value] : *fields)
    again += (again.empty() ? "" : "&") + escaped(name) + "=" + escaped(value);
  require(parse_form(again) == fields || fields->empty(), "a form read otherwise the second time");
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  read_form(text);
  const std::optional<Target> target = parse_target(text);
  if (!target) return 0;
  require(std::all_of(text.begin(), text.end(), is_printable), "a byte that no target may have");
  require(target->path.starts_with('/'), "a path that begins nowhere");
  require(target->path == text.substr(0, text.find('?')), "another path than was sent");
  if (target->path.find('%') == std::string::npos) {
    std::string joined;
    for (const std::string& word : target->words) joined += "/" + word;
    require(joined == target->path || (joined.empty() && target->path == "/"), "parts that were not sent");
  }
  const std::optional<Target> same = parse_target(written(*target));
  require(same && same->words == target->words, "read otherwise the second time");
  return 0;
}
