#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Requests as pages send them, put together at random, then changed at a few places. The fuzz target aborts
/// if one is misread.
std::string mutated_request(std::mt19937& random) {
  static const std::string kKeys[] = {"do",   "id",          "confirmed",    "axis",    "by_deg", "run",
                                      "text", "with_motion", "from_another", "release", "speed"};
  static const std::string kValues[] = {
      "true",         "false",       "null",        "0",        "-1",        "7",          "1e999",
      "12.5",         "-360",        "360.0000001", "[]",       "{}",        "\"x\"",      "\"z\"",
      "\"start\"",    "\"stop\"",    "\"jog\"",     "\"note\"", "\"check\"", "\"resume\"", "\"control\"",
      "\"../a.run\"", "\"\\u0000\"", "\"\\ud800\""};
  static const std::string kDo[] = {"start",  "stop",    "jog",  "note",    "check",
                                    "resume", "control", "hold", "continue"};
  std::string text = "{\"do\":\"" + kDo[random() % std::size(kDo)] + "\"";
  for (std::size_t keys = random() % 5; keys > 0; --keys)
    text += ",\"" + kKeys[random() % std::size(kKeys)] + "\":" + kValues[random() % std::size(kValues)];
  if (random() % 2 == 0) text += ",\"confirmed\":true";
  text += "}";
  for (std::size_t changes = random() % 4; changes > 0; --changes) {
    const std::size_t at = random() % text.size();
    switch (random() % 3) {
      case 0:
        text.insert(at, 1, static_cast<char>(random()));
        break;
      case 1:
        text.insert(at, text.substr(at, random() % 300));
        break;
      default:
        text[at] = static_cast<char>(text[at] ^ (1 << random() % 8));
    }
  }
  return text;
}

TEST(ConsoleCodecFuzzTest, NeverTakesARequestForAnother) {
  test::show_target_seeded(20261121, 50'000, mutated_request);
}

}  // namespace
}  // namespace abcal
