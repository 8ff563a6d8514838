#include <gtest/gtest.h>

#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

using namespace std::string_literals;

/// Messages as controllers send them, then changed at a few places.
std::string mutated_messages(std::mt19937& random) {
  static const std::string kMessages[] = {
      "\x91\x04\x0E\x00\x81\x21\x01\x00\x00\x20\x03\x00\x00\x00\x00\x00\x00\x34\x00\x90"s,
      "\x81\x04\x0E\x00\x81\x50\x01\x00\x00\x20\x03\x00\x00\x20\x03\x00\x10\x04\x00\x80"s,
      "\x64\x04\x01\x00\x01\x50"s,
      "\x15\x04\x0E\x00\x81\x22\x01\x00\x00\x00\x00\x00\x05\x00\x00\x00\x00\x00\x10\x00"s,
      "\x06\x00\x54\x00\x81\x11"s + "\x40\xE2\x01\x00"s + "BBD202\0\0"s + std::string(72, '\x01'),
      "\xF2\x04\x4A\x00\x81\x21\x01\x00\x00\x00\x00\x00"s + "DDR100"s + std::string(62, '\0'),
      "\x81\x00\x44\x00\x81\x21\x53\x04\x04\x00"s + "No"s + std::string(62, '\0')};
  return test::mutated(kMessages, 4, random);
}

TEST(ThorlabsAptCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(1152, 5'000, mutated_messages);
}

}  // namespace
}  // namespace abcal
