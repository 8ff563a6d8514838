#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Replies, then changed at a few places.
std::string changed_replies(std::mt19937& random) {
  static const std::string kLines[] = {"+ 0007",
                                       "+ RT-2 sn=00412 fw=3.07",
                                       "- 12 not referenced",
                                       "+ 12.5",
                                       "@01 1 OK IDLE -- 384000",
                                       "@01 1 OK BUSY FS 0",
                                       "! alert",
                                       "GO O 12.5",
                                       "39,007",
                                       "12TS000028",
                                       "-2147483640",
                                       "RTVR",
                                       "0, 1,1",
                                       "1 2  3",
                                       "+ -3 0012",
                                       "{word}"};
  std::string bytes;
  for (std::size_t lines = 1 + random() % 4; lines > 0; --lines)
    bytes += kLines[random() % std::size(kLines)] + (random() % 4 != 0 ? "\r\n" : "\r");
  for (std::size_t changes = random() % 4; changes > 0; --changes) {
    const std::size_t at = random() % bytes.size();
    if (random() % 2 == 0) {
      bytes.insert(at, 1, static_cast<char>(random()));
    } else {
      bytes[at] = static_cast<char>(random());
    }
  }
  return bytes;
}

TEST(DescribedCodecFuzzTest, FormsAgreeWithPatternsOnSeededMutations) {
  std::mt19937 random(66);
  for (int n = 0; n < 4000; ++n) test::show_target(changed_replies(random));
}

}  // namespace
}  // namespace abcal
