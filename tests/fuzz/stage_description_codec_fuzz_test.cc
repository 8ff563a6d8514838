#include <gtest/gtest.h>

#include <cstddef>
#include <deque>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/stage_description_file.h"
#include "drivers/text/text.h"
#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

/// A shipped description, of which some lines are lost, twice there, from another one, or changed by a
/// character.
std::string changed_description(std::mt19937& random) {
  const auto& all = shipped_descriptions();
  const auto lines_of = [&] { return pieces::split(all[random() % all.size()].text, '\n'); };
  std::vector<std::string_view> lines = lines_of();
  const std::vector<std::string_view> others = lines_of();
  std::deque<std::string> changed;  // Lines refer to it.
  for (std::size_t changes = random() % 4; changes > 0; --changes) {
    const std::size_t at = random() % lines.size();
    switch (random() % 4) {
      case 0:
        lines.erase(lines.begin() + static_cast<std::ptrdiff_t>(at));
        break;
      case 1:
        lines.insert(lines.begin() + static_cast<std::ptrdiff_t>(at), lines[random() % lines.size()]);
        break;
      case 2:
        lines[at] = others[random() % others.size()];
        break;
      default: {
        std::string& line = changed.emplace_back(lines[at]);
        if (!line.empty()) line[random() % line.size()] = static_cast<char>(' ' + random() % 95);
        lines[at] = line;
      }
    }
  }
  std::string text;
  for (const std::string_view line : lines) text.append(line) += '\n';
  return text;
}

TEST(StageDescriptionCodecFuzzTest, TheReaderRefusesOrHoldsItsPromises) {
  for (const ShippedDescription& shipped : shipped_descriptions()) test::show_target(shipped.text);
  test::show_target_seeded(74, 1500, changed_description);
}

}  // namespace
}  // namespace abcal
