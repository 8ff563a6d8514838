#include <gtest/gtest.h>

#include <array>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

TEST(WatlowF4CodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  using namespace std::string_literals;
  const std::array samples{"\x01\x03\x02\x00\x01\x79\x84"s,
                           "\x01\x03\x02\x00\xEA\x39\xCB"s,
                           "\x01\x06\x01\x2C\xFE\x70\x08\x7B"s,
                           "\x01\x86\x03\x02\x61"s,
                           "\x00\x01\x00\x00\x00\x07\x01\x03\x04\x33\x33\x41\xBB"s,
                           "\x00\x01\x00\x00\x00\x06\x01\x10\x0A\xDE\x00\x02"s};
  test::show_target_seeded(20261122, 10'000,
                           [&](std::mt19937& random) { return test::mutated(samples, 3, random); });
}

}  // namespace
}  // namespace abcal
