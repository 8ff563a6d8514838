#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Lines as boards print them, then changed at a few places. The fuzz target aborts if reader and reference
/// differ.
std::string mutated_lines(std::mt19937& random) {
  static const std::string kWords[] = {
      "0.01", "-9.80665", "+1",   ".5",     "5.", "1e-3",  "-1.5E+10", "nan",     "-inf",    "",   "16384",
      "x",    "1 2",      "1e99", "2.5e-9", "0",  "1e999", "-0.0",     "\"7.5\"", "\" 8 \"", "\"", "\"1,2\""};
  static const std::string kEnds[] = {"\r\n", "\n", "\r", "\r\r\n"};
  const std::string separator(1, ", ;\t"[random() % 4]);
  const std::string end = kEnds[random() % std::size(kEnds)];
  std::string bytes{static_cast<char>(random()), static_cast<char>(random())};
  for (std::size_t lines = 1 + random() % 12; lines > 0; --lines) {
    switch (random() % 10) {
      case 0:
        bytes += "# a comment";
        break;
      case 1:
        bytes += "u,v,w";
        break;
      case 2:
        bytes += std::string(random() % 3000, '7');
        break;
      default:
        for (std::size_t words = 1 + random() % 5; words > 0; --words)
          bytes += kWords[random() % std::size(kWords)] + (words > 1 ? separator : "");
    }
    bytes += end;
  }
  for (std::size_t changes = random() % 8; changes > 0; --changes) {
    const std::size_t at = 2 + random() % (bytes.size() - 2);
    switch (random() % 4) {
      case 0:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 1:
        bytes.erase(at, 1);
        break;
      case 2:
        bytes.insert(at, bytes.substr(at, random() % 300));
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
    if (bytes.size() < 3) break;
  }
  return bytes;
}

TEST(TextLineCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240303, 10'000, mutated_lines);
}

TEST(TextLineCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEnd) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_lines(random));
}

}  // namespace
}  // namespace abcal
