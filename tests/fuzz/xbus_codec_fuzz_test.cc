#include <gtest/gtest.h>

#include <cstddef>
#include <random>
#include <string>

#include "tests/drivers/xsens_mti/reference_decoder.h"
#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

namespace reference = test::xbus_reference;

std::string random_bytes(std::mt19937& random, std::size_t count) {
  std::string bytes(count, '\0');
  for (char& byte : bytes) byte = static_cast<char>(random());
  return bytes;
}

std::string some_message(std::mt19937& random) {
  switch (random() % 6) {
    case 0:
      return reference::message(random() % 256, random_bytes(random, random() % 20));
    case 1:  // Long enough for the extended length.
      return reference::message(0x0D, random_bytes(random, 240 + random() % 40));
    default: {
      std::string items = reference::item(0x1020, random_bytes(random, 2));
      for (std::size_t n = random() % 5; n > 0; --n) {
        constexpr std::size_t kBytes[] = {4, 4, 6, 8};
        const unsigned format = random() % 4;
        const unsigned id = random() % 2 == 0 ? 0x4020 : 0x0810;
        items += reference::item(id + format, random_bytes(random, kBytes[format] * (id == 0x4020 ? 3 : 1)));
      }
      return reference::message(0x36, items);
    }
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
        bytes.insert(at, "\xFA\xFF");
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
        bytes.insert(at, std::string("\xFA\xFF\x36\xFF\x00\x40", 6));
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(XbusCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240301, 10'000, mutated_stream);
}

TEST(XbusCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEndOfAStream) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_stream(random));
}

}  // namespace
}  // namespace abcal
