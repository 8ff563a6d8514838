#include <gtest/gtest.h>

#include <cstddef>
#include <iterator>
#include <random>
#include <string>

#include "app/witness/witness_line.h"
#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

std::string any_text(std::mt19937& random) {
  static const std::string kParts[] = {"run-1",
                                       "\"",
                                       "\\",
                                       "\n",
                                       "\t",
                                       "\xc3\xa4",
                                       "\xe2\x82\xac",
                                       "\xf0\x9f\x98\x80",
                                       " ",
                                       "/",
                                       "{",
                                       "\x7f",
                                       std::string(60, 'x')};
  std::string text = "1";
  for (std::size_t parts = random() % 5; parts > 0; --parts) text += kParts[random() % std::size(kParts)];
  return text;
}

std::string any_link(std::mt19937& random) {
  std::string link;
  while (link.size() < 64) link += "0123456789abcdef"[random() % 16];
  return link;
}

/// A line, most of the time a good one.
std::string any_line(std::mt19937& random) {
  WitnessStatement line;
  line.what = static_cast<WitnessAct>(random() % 4);
  line.counter = random() % 3;
  line.utc = random() % 4 == 0 ? "2025-02-29T12:00:00.000Z" : "2026-03-01T12:34:56.789Z";
  line.boot_id = any_text(random);
  line.since_boot_ns = static_cast<std::int64_t>(random());
  line.uid = random() % 2000;
  line.run = any_text(random);
  line.bench = any_text(random);
  line.person = any_text(random);
  line.register_identity = any_text(random);
  line.k = random() % 3;
  line.entries = random() % 3;
  line.simulated = random() % 2 == 0;
  line.head = any_link(random);
  line.previous = any_link(random);
  line.now = any_link(random);
  line.events = any_link(random);
  if (line.counter != 1 || random() % 4 == 0) line.before = any_link(random);
  return random() % 4 == 0 ? to_json(line) : to_line(line);
}

TEST(WitnessCodecFuzzTest, AgreesWithTheReferenceOnSeededLines) {
  test::show_target_seeded(20261127, 3'000, any_line);
}

TEST(WitnessCodecFuzzTest, AgreesWithTheReferenceOnChangedLines) {
  test::show_target_seeded(20261128, 10'000, [](std::mt19937& random) {
    const std::string lines[] = {any_line(random)};
    return test::mutated(lines, 1, random);
  });
}

TEST(WitnessCodecFuzzTest, AgreesWithTheReferenceOnEveryStartAndEnd) {
  std::mt19937 random(7);
  test::show_target_every_part(any_line(random));
}

}  // namespace
}  // namespace abcal
