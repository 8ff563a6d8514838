#include <gtest/gtest.h>

#include <cstddef>
#include <random>
#include <string>

#include "tests/drivers/microstrain_mip/reference_decoder.h"
#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

namespace reference = test::mip_reference;

/// A stream as a device sends it, then changed at a few places. The fuzz target aborts if codec and reference
/// differ.
std::string mutated_stream(std::mt19937& random) {
  std::string bytes(1, static_cast<char>(random()));
  for (std::size_t packets = 1 + random() % 12; packets > 0; --packets) {
    std::string payload;
    for (std::size_t fields = random() % 5; fields > 0; --fields) {
      constexpr std::size_t kLengths[] = {0, 2, 8, 12, 12, 82};
      std::string data(kLengths[random() % 6], '\0');
      for (char& byte : data) byte = static_cast<char>(random());
      if (payload.size() + data.size() + 2 <= 255) payload += reference::field_bytes(random() % 256, data);
    }
    bytes += reference::packet(random() % 2 ? 0x80 : random() % 256, payload);
  }
  for (std::size_t changes = random() % 8; changes > 0; --changes) {
    const std::size_t at = 1 + random() % (bytes.size() - 1);
    switch (random() % 5) {
      case 0:
        bytes.insert(at, "ue");
        break;
      case 1:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 2:
        bytes.resize(at + 1);
        break;
      case 3:
        bytes.insert(at, bytes.substr(at, random() % 300));
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(MipCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240229, 20'000, mutated_stream);
}

TEST(MipCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEndOfAStream) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_stream(random));
}

}  // namespace
}  // namespace abcal
