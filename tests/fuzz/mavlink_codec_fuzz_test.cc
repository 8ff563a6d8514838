#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <random>
#include <string>

#include "tests/fuzz/mutated_samples.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace abcal {
namespace {

using namespace std::string_literals;

/// Frames of both versions, then changed at a few places.
std::string mutated_frames(std::mt19937& random) {
  static const std::string kFrames[] = {
      "\xfd\x18\x00\x00\x07\x01\x01\x1a\x00\x00\xe8\x03\x00\x00\x01\x00\xfe\xff\x18\xfc\x03\x00\x04\x00\x05\x00\x06\x00\x07\x00\x08\x00\xc4\x09\xf5\xc9"s,
      "\xfe\x18\x09\x01\x01\x1a\xe8\x03\x00\x00\x01\x00\xfe\xff\x18\xfc\x03\x00\x04\x00\x05\x00\x06\x00\x07\x00\x08\x00\x00\x00\xfb\x5d"s,
      "\xfd\x09\x00\x00\x00\x01\x01\x00\x00\x00\x00\x00\x00\x00\x02\x03\x00\x04\x03\x4a\xd7"s,
      "\xfd\x0e\x00\x00\x0b\x01\x01\x1b\x00\x00\x40\x42\x0f\x00\x00\x00\x00\x00\x01\x00\x02\x00\x18\xfc\x57\x7d"s,
      "\xfd\x02\x00\x00\x0b\x01\x01\xf0\x00\x00\x40\x42\x12\x34"s};
  return test::mutated(kFrames, 5, random);
}

TEST(MavlinkCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  std::mt19937 random(14550);
  for (int i = 0; i < 5'000; ++i) {
    const std::string input = mutated_frames(random);
    LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
  }
}

}  // namespace
}  // namespace abcal
