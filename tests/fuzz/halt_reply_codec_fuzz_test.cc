#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

using namespace std::string_literals;

/// Replies as controllers send them, also too long ones, with every terminator, then changed at a few places.
std::string mutated_replies(std::mt19937& random) {
  static const std::string kReplies[] = {"0,7",
                                         "0,39",
                                         "0,40",
                                         "0,263",
                                         "0,264",
                                         "0,07",
                                         " 0 ",
                                         "0",
                                         "000",
                                         "1",
                                         "aF",
                                         "@02 1 41 0 OK IDLE",
                                         "@12 f OK ",
                                         "-22,x",
                                         "aaab",
                                         "\x2a\x04\x21\x81\x00\x04"s,
                                         "\x2a\x04\x50\x0d\x0f\xfd"s,
                                         "\x2a\x04\x50\x0a\x10\x00"s,
                                         "\x2a\x04\x22\x81\x00\x04"s};
  static const std::string kEnds[] = {"\r\n", "\n", "\r", "", ",EndOfAPI", ",EndOfAP", "aab"};
  // Mostly one terminator, so that replies are found.
  const std::size_t usual = random() % std::size(kEnds);
  std::string bytes{static_cast<char>(random() % 128), static_cast<char>(random())};
  for (std::size_t replies = 1 + random() % 6; replies > 0; --replies) {
    if (random() % 6 == 0) bytes += std::string(random() % 600, " 0x,"[random() % 4]);
    bytes += kReplies[random() % std::size(kReplies)];
    bytes += kEnds[random() % 4 == 0 ? random() % std::size(kEnds) : usual];
  }
  for (std::size_t changes = random() % 3; changes > 0 && bytes.size() > 3; --changes) {
    const std::size_t at = 2 + random() % (bytes.size() - 2);
    if (random() % 2 == 0) {
      bytes.erase(at, 1);
    } else {
      bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

/// A pattern of few different bytes, and a reply of the same.
std::string any_pattern(std::mt19937& random) {
  static const char kBytes[] = {'0', '0', '1', '9', 'a', ' ', '\n', '\0', '\xff'};
  std::string bytes{static_cast<char>(128 + random() % 128), '\0', static_cast<char>(random())};
  const std::size_t different = 1 + random() % std::size(kBytes);
  for (std::size_t parts = random() % 16; parts > 0; --parts) {
    bytes += static_cast<char>(random());
    for (std::size_t count = random() % 4; count > 0; --count) bytes += kBytes[random() % different];
  }
  for (std::size_t count = random() % (random() % 8 == 0 ? 300 : 12); count > 0; --count)
    bytes += kBytes[random() % different];
  return bytes;
}

TEST(HaltReplyCodecFuzzTest, AgreesWithTheReferenceOnSeededReplies) {
  test::show_target_seeded(20261125, 3'000, mutated_replies);
}

TEST(HaltReplyCodecFuzzTest, AgreesWithTheReferenceOnAnyPattern) {
  test::show_target_seeded(20261126, 10'000, any_pattern);
}

TEST(HaltReplyCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEnd) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_replies(random));
}

}  // namespace
}  // namespace abcal
