#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// Replies as voltmeters send them, then changed at a few places.
std::string mutated_replies(std::mt19937& random) {
  static const std::string kReplies[] = {"+1.22994148E-02,-4.56000771E-01,+4.90120051E+00",
                                         "+5.00000000E-01,101,-2.50000000E-01,102,+3.12500000E+00,103",
                                         "+3.12500000E+00 VDC,103,+5.00000000E-01 VDC,101",
                                         "+7.22491127E+00VDC,000",
                                         "+9.90000000E+37,101,-9.9E37,102,+9.91E+37,103",
                                         "HEWLETT-PACKARD,34970A,MY44012345,13-2-2",
                                         "KEITHLEY INSTRUMENTS INC.,MODEL 2700,1234567,B02  /A02",
                                         "+0,\"No error\"",
                                         "0, \"no error\"",
                                         "-113,\"Undefined header; \"\"X\"\"\"",
                                         "#214(@101,102,103)",
                                         "(@101:103,7)",
                                         "1"};
  static const std::string kPieces[] = {",", "\"",  "E",  "e-400", "+", "-",  ".",
                                        " ", "VDC", "\n", "#",     ":", "inf"};
  std::string bytes;
  for (std::size_t replies = 1 + random() % 4; replies > 0; --replies)
    bytes += kReplies[random() % std::size(kReplies)] + (random() % 4 != 0 ? "\n" : "\r\n");
  for (std::size_t changes = random() % 5; changes > 0 && !bytes.empty(); --changes) {
    const std::size_t at = random() % bytes.size();
    switch (random() % 5) {
      case 0:
        bytes.insert(at, 1, static_cast<char>(random()));
        break;
      case 1:
        bytes.erase(at, 1);
        break;
      case 2:
        bytes.insert(at, kPieces[random() % std::size(kPieces)]);
        break;
      case 3:
        bytes.insert(at, bytes.substr(random() % bytes.size(), random() % 40));
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    }
  }
  return bytes;
}

TEST(ScpiVoltmeterCodecFuzzTest, AgreesWithTheReferenceOnSeededMutations) {
  test::show_target_seeded(20240318, 10'000, mutated_replies);
}

TEST(ScpiVoltmeterCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEnd) {
  std::mt19937 random(7);
  test::show_target_every_part(mutated_replies(random));
}

}  // namespace
}  // namespace abcal
