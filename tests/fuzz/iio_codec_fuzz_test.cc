#include <gtest/gtest.h>

#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

using namespace std::string_literals;

TEST(IioCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  static const std::string kReplies[] = {
      "0\n",
      "-22\n",
      "9\n0.598550\0\n"s,
      "14\nadis16485-dev0\n",
      "0.24.v0.24  \n",
      "24\n00000047\nABCDEFGHIJKLMNOPQRSTUVWX",
      "8\n00000047\nABCDEFGH16\nIJKLMNOPQRSTUVWX",
      "be:s20/32>>12\n\x80\x00\x0f\xff",
      "le:S64/64>>0\n\xff\xff\xff\xff\xff\xff\xff\x7f",
      "<context><device id=\"d\" name=\"n\"><channel id=\"accel_x\" type=\"input\"><scan-element index=\"0\" "
      "format=\"le:s16/16>>0\"/></channel><channel id=\"accel_y\" type=\"input\"><scan-element index=\"1\" "
      "format=\"le:s16/16>>0\"/></channel><channel id=\"accel_z\" type=\"input\"><scan-element index=\"2\" "
      "format=\"le:s16/16>>0\"/></channel></device></context>"};
  test::show_target_seeded(30431, 5'000,
                           [&](std::mt19937& random) { return test::mutated(kReplies, 3, random); });
}

}  // namespace
}  // namespace abcal
