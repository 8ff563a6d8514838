#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Targets as browsers and attackers send them, put together at random, then changed at a few places. The
/// fuzz target aborts if one is misread.
std::string mutated_target(std::mt19937& random) {
  static const std::string kParts[] = {"/runs",   "/a.run", "/result", "/..",     "/.",  "/%2e%2e", "%2f",
                                       "%5c",     "%00",    "/",       "//",      "\\",  "%",       "%zz",
                                       "/%C3%A4", "?",      "?token=", "&token=", "%26", "#",       ":",
                                       "@",       "+",      "http:",   "a b",     "\xff"};
  std::string text = random() % 4 == 0 ? "" : "/";
  for (std::size_t parts = random() % 6; parts > 0; --parts) text += kParts[random() % std::size(kParts)];
  if (text.empty()) return text;
  for (std::size_t changes = random() % 3; changes > 0; --changes) {
    const std::size_t at = random() % text.size();
    if (random() % 2 == 0) {
      text.insert(at, 1, static_cast<char>(random()));
    } else {
      text[at] = static_cast<char>(text[at] ^ (1 << random() % 8));
    }
  }
  return text;
}

TEST(ConsoleTargetCodecFuzzTest, TakesApartWhatWasSentAndNothingElse) {
  test::show_target_seeded(20261121, 50'000, mutated_target);
}

}  // namespace
}  // namespace abcal
