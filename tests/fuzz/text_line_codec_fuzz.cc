// Fuzz target of the reader of lines of text: whatever the bytes and however they are split, it finds exactly
// the lines of numbers that the slow reference finds, and gives each the numbers that the C library reads.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// text_line_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <string_view>

#include "drivers/text_line/codec.h"
#include "tests/drivers/text_line/reference_reader.h"

namespace {

namespace text_line = abcal::text_line;
namespace reference = abcal::test::text_line_reference;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "reader of lines and reference differ: %s\n", what);
  std::abort();
}

bool same(double a, double b) {
  return a == b || (a != a && b != b);
}

}  // namespace

// The first byte says how the rest is split, the second what the lines look like.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  constexpr std::string_view kSeparators = ", ;\t";
  const std::size_t piece = 1 + data[0] % 64;
  reference::Format format;
  format.separator = kSeparators[data[1] % 4];
  static const std::string kComments[] = {"#", "//", "", "#"};
  format.comment = kComments[data[1] / 4 % 4];
  if ((data[1] & 16U) != 0) format.columns = {2};
  if ((data[1] & 32U) != 0) format.columns = {4, 1};
  format.required_words = data[1] / 64U;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 2, size - 2);
  const reference::Decoded expected = reference::decode(bytes, format);

  text_line::LineReader reader(
      {.columns = format.columns, .separator = std::string(1, format.separator), .comment = format.comment});
  if (format.required_words != 0) reader.require_words(format.required_words);
  std::size_t found = 0;
  std::size_t used = 0;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    reader.feed(bytes.substr(at, piece));
    while (const auto line = reader.next()) {
      require(found < expected.lines.size(), "a line too many");
      require(line->values.size() == expected.lines[found].size(), "how many numbers");
      for (std::size_t i = 0; i < line->values.size(); ++i)
        require(same(line->values[i], expected.lines[found][i]), "number");
      require(line->words == expected.words[found++], "columns");
      used += line->size;
    }
  }
  require(found == expected.lines.size(), "a line missing");
  require(reader.header_lines() == expected.headers, "headers");
  require(reader.bad_frames() == expected.bad_lines, "bad lines");
  require(reader.skipped_bytes() == expected.skipped_bytes, "skipped bytes");
  require(used + reader.skipped_bytes() <= bytes.size(), "bytes given twice");
  return 0;
}
