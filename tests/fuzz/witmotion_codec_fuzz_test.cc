#include <gtest/gtest.h>

#include <cstddef>
#include <random>
#include <string>

#include "tests/drivers/witmotion/reference_decoder.h"
#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

namespace reference = test::witmotion_reference;

/// A stream as a device sends it, then changed at a few places. The fuzz target aborts if codec and reference
/// differ.
std::string mutated_stream(std::mt19937& random) {
  const auto word = [&random] { return static_cast<int>(random() % 65536) - 32768; };
  std::string bytes(1, static_cast<char>(random()));
  for (std::size_t frames = 1 + random() % 12; frames > 0; --frames) {
    const int type = random() % 3 == 0 ? 0x50 + static_cast<int>(random() % 16) : 0x51;
    bytes += reference::frame(type, {word(), word(), word(), word()});
  }
  for (std::size_t changes = random() % 8; changes > 0; --changes) {
    const std::size_t at = 1 + random() % (bytes.size() - 1);
    switch (random() % 5) {
      case 0:
        bytes.insert(at, "UQ");
        break;
      case 1:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 2:
        bytes.resize(at + 1);
        break;
      case 3:
        bytes.insert(at, bytes.substr(at, random() % 30));
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(WitMotionCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240302, 10'000, mutated_stream);
}

TEST(WitMotionCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEndOfAStream) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_stream(random));
}

}  // namespace
}  // namespace abcal
