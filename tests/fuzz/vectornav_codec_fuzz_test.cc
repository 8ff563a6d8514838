#include <gtest/gtest.h>

#include <cstddef>
#include <random>
#include <string>

#include "tests/drivers/vectornav/reference_decoder.h"
#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

namespace reference = test::vectornav_reference;

std::string some_message(std::mt19937& random) {
  const auto number = [&random] {
    return static_cast<float>(static_cast<int>(random() % 40001) - 20000) / 1000.0F;
  };
  switch (random() % 5) {
    case 0: {
      std::string text = "VNACC";
      for (int i = 0; i < 3; ++i) text += "," + std::to_string(number());
      return reference::text_message(text, random() % 2 == 0);
    }
    case 1: {
      std::string text = random() % 2 == 0 ? "VNIMU" : "VNYMR";
      for (std::size_t n = 10 + random() % 4; n > 0; --n) text += "," + std::to_string(number());
      if (random() % 3 == 0) text += ",T00001234,S01AF";
      return reference::text_message(text, random() % 2 == 0);
    }
    case 2:
      return reference::text_message("VNWRG,75,3,8,05,0101,0010", random() % 2 == 0);
    case 3: {
      std::string payload(28, '\0');
      for (char& byte : payload) byte = static_cast<char>(random());
      return reference::binary_message("\x01" + reference::little_endian(0x1400, 2) + payload.substr(0, 22));
    }
    default:
      return reference::data_message(random(), number(), number(), number(), number());
  }
}

/// A stream as a device sends it, then changed at a few places. The fuzz target aborts if codec and reference
/// differ.
std::string mutated_stream(std::mt19937& random) {
  std::string bytes(1, static_cast<char>(random()));
  for (std::size_t messages = 1 + random() % 12; messages > 0; --messages) bytes += some_message(random);
  for (std::size_t changes = random() % 8; changes > 0; --changes) {
    const std::size_t at = 1 + random() % (bytes.size() - 1);
    switch (random() % 6) {
      case 0:
        bytes.insert(at, "$VN");
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
      case 4:
        bytes.insert(at, "\xFA\x05\x01");
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(VectorNavCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240301, 10'000, mutated_stream);
}

TEST(VectorNavCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEndOfAStream) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_stream(random));
}

}  // namespace
}  // namespace abcal
