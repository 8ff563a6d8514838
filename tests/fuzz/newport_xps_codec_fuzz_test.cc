#include <gtest/gtest.h>

#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Replies as a controller sends them, then changed at a few places.
std::string mutated_replies(std::mt19937& random) {
  static const std::string kReplies[] = {"0,XPS-C8 Firmware V2.6.0,EndOfAPI",
                                         "0,,EndOfAPI",
                                         "0,12.5,-3.25,EndOfAPI",
                                         "0,44,EndOfAPI",
                                         "-22,GroupInitialize(G),EndOfAPI",
                                         "0,20,80,0.02,0.02,EndOfAPI",
                                         "-1,GroupStatusGet(Group1,int *),EndOfAPI",
                                         "0,1.5e-07,EndOfAPI"};
  return test::mutated(kReplies, 4, random);
}

TEST(NewportXpsCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(5001, 5'000, mutated_replies);
}

}  // namespace
}  // namespace abcal
