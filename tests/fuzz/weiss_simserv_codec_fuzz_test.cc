#include <gtest/gtest.h>

#include <array>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

TEST(WeissSimservCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  const std::array<std::string, 8> samples{
      "1\xB6"
      "22.9\r\n",
      "1\r\n",
      "-5\r\n",
      "0\r",
      "0050.0 0024.6 0080.0 0066.7 0090.0 01100000000000000000000000000000\r",
      "-075.0 -038.3 0101000000000000Z\r",
      "$01E CV01 CV02 SV01 DO00 DO01 <CR>\r\nCV01 CV01 CV02 CV02 DO00 DO01\r\n",
      "CV01  value min:  -77.0   Value max:  182.0   Temperature\r\nDO01  Start\r\n"};
  test::show_target_seeded(20261122, 10'000,
                           [&](std::mt19937& random) { return test::mutated(samples, 4, random); });
}

}  // namespace
}  // namespace abcal
