#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Replies as controllers send them, then changed at a few places.
std::string mutated_replies(std::mt19937& random) {
  static const std::string kReplies[] = {
      "(c)2013 Physik Instrumente (PI) GmbH & Co. KG, C-884.4DC, 123456, 1.2.3\n",
      "(c)2013 Physik Instrumente(PI) Karlsruhe, E-861 Version 7.2.0\n",
      "1=14.500000\n",
      "1=10.0000 \n2=20.0000\n",
      "0 2 1=-360.0 \n2=+3.6e2\n",
      "0 16 1=1\n",
      "14=10000\n",
      "1 0x406=0.001 \n1 0x3F=1\n",
      "1=DEG\n",
      "1=M-060.PD \r\n2=NOSTAGE\r\n",
      "0x300150041000\n",
      "A\n",
      "0\n",
      "-7\n",
      "#4 request status \nMOV {<axis> <position>} \nend of help\n",
      "deg\n",
      "\xB1"};
  static const std::string kPieces[] = {"=",     " ",  "\n",  " \n", ".",  "+", "-",
                                        "e-400", "0x", "inf", "\t",  "\r", ","};
  std::string bytes;
  for (std::size_t replies = 1 + random() % 4; replies > 0; --replies)
    bytes += kReplies[random() % std::size(kReplies)];
  for (std::size_t changes = random() % 5; changes > 0 && !bytes.empty(); --changes) {
    const std::size_t at = random() % bytes.size();
    switch (random() % 4) {
      case 0:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 1:
        bytes.erase(at, 1);
        break;
      case 2:
        bytes.insert(at, kPieces[random() % std::size(kPieces)]);
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(PiGcsCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240229, 10'000, mutated_replies);
}

TEST(PiGcsCodecFuzzTest, AgreesWithTheReferenceOnRandomBytes) {
  test::show_target_seeded(7, 10'000, [](std::mt19937& random) {
    std::string input(random() % 60, '\0');
    for (char& byte : input) byte = "\n 0123456789.=+-eExX,Aa\t\r\xB0"[random() % 26];
    return input;
  });
}

TEST(PiGcsCodecFuzzTest, AgreesWithTheReferenceOnRepliesAboutAsLongAsTheyMayBe) {
  for (const std::size_t size : {65534U, 65535U, 65536U, 65537U}) {
    test::show_target(std::string(size, '1') + "\n");
    test::show_target(std::string(size, '1'));
    test::show_target("1=" + std::string(size, ' ') + "\n0\n");
  }
}

}  // namespace
}  // namespace abcal
