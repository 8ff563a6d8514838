#include <gtest/gtest.h>

#include <cstddef>
#include <cstdio>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// The checksum as the maker words it: sum, XOR FF, plus 1.
std::string checksummed(const std::string& line) {
  unsigned sum = 0;
  for (std::size_t n = 1; n < line.size(); ++n) sum += static_cast<unsigned char>(line[n]);
  char digits[8];
  std::snprintf(digits, sizeof digits, ":%02X", ((sum ^ 0xFFU) + 1U) & 0xFFU);
  return line + digits;
}

/// Lines as devices send them, then changed at a few places.
std::string mutated_lines(std::mt19937& random) {
  static const std::string kLines[] = {
      "@01 0 OK IDLE -- 0",           "@01 2 OK IDLE -- 1.2 3.4",      "@01 1 12 RJ IDLE -- BADCOMMAND",
      "@01 0 OK IDLE FS 10000",       "@02 1 05 OK BUSY WR 02 WR NC",  "#01 2",
      "#01 2 cont 56 message \\",     "!01 2 BUSY FF words go here\\", "!01 2 IDLE --",
      "@99 9 99 OK IDLE -- NA 384000"};
  std::string bytes;
  for (std::size_t lines = 1 + random() % 4; lines > 0; --lines) {
    const std::string& line = kLines[random() % std::size(kLines)];
    bytes += (random() % 2 != 0 ? checksummed(line) : line) + (random() % 4 != 0 ? "\r\n" : "\n");
  }
  for (std::size_t changes = random() % 4; changes > 0; --changes) {
    const std::size_t at = random() % bytes.size();
    switch (random() % 3) {
      case 0:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 1:
        bytes.erase(at, 1);
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(ZaberAsciiCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240229, 10'000, mutated_lines);
}

TEST(ZaberAsciiCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEnd) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_lines(random));
}

}  // namespace
}  // namespace abcal
