#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Lines as a controller sends them, then changed at a few places.
std::string mutated_lines(std::mt19937& random) {
  static const std::string kLines[] = {"ESP301 Version 3.0.1 6/1/99\r\n",
                                       "0, 450322, NO ERROR DETECTED\r\n",
                                       "9, 87498349, ERROR\r\n",
                                       "URS100BCC, SN12345\r\n",
                                       "12.34500\r\n",
                                       "-1.5E-3\r",
                                       "7\n",
                                       "1\r\n",
                                       "0\r",
                                       "24H\r\n",
                                       "E38\r\n",
                                       "0H, 0H\r\n"};
  std::string bytes;
  for (std::size_t lines = 1 + random() % 5; lines > 0; --lines)
    bytes += kLines[random() % std::size(kLines)];
  for (std::size_t changes = random() % 4; changes > 0; --changes) {
    const std::size_t at = random() % bytes.size();
    switch (random() % 3) {
      case 0:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 1:
        bytes.erase(at, 1);
        if (bytes.empty()) return "\r";
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(NewportEspCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240229, 3'000, mutated_lines);
}

TEST(NewportEspCodecFuzzTest, AgreesWithTheReferenceOnRandomBytes) {
  test::show_target_seeded(7, 3'000, [](std::mt19937& random) {
    std::string input(random() % 600, '\0');
    for (char& byte : input) byte = "\r\n0123456789.,-+eE SNabcx\xFF"[random() % 26];
    return input;
  });
}

}  // namespace
}  // namespace abcal
