#include "app/bench_file/key_reference.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "app/bench_file/bench_config.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::HasSubstr;

const BenchKey& key_of(const std::vector<BenchKey>& keys, const std::string& section,
                       const std::string& name) {
  const auto found = std::find_if(keys.begin(), keys.end(), [&](const BenchKey& key) {
    return key.section == section && key.key == name;
  });
  EXPECT_NE(found, keys.end()) << section << "." << name;
  return found == keys.end() ? keys.front() : *found;
}

TEST(KeyReferenceTest, ThePageIsWhatTheProgramPrints) {
  // Made with `abcal plan --keys > docs/bench_file.md`.
  EXPECT_EQ(test::read_file(test::source_folder() / "docs/bench_file.md"), bench_file_page());
}

/// A name that is no key would leave its row out.
TEST(KeyReferenceTest, ThePageBeginsWithTheKeysThatEveryoneHas) {
  const std::string page = bench_file_page();
  const std::size_t from = page.find("## The keys that everyone has");
  ASSERT_NE(from, std::string::npos);
  const std::string first = page.substr(from, page.find("\n## ", from) - from);
  std::size_t rows = 0;
  for (std::size_t at = first.find("\n| `["); at != std::string::npos; at = first.find("\n| `[", at + 1))
    ++rows;
  EXPECT_EQ(rows, 15U);
}

TEST(KeyReferenceTest, EveryKeyHasAMeaning) {
  for (const BenchKey& key : bench_keys()) {
    EXPECT_FALSE(key.meaning.empty())
        << "[" << key.section << "] " << key.key << " has no line in key_meanings.cc";
  }
}

TEST(KeyReferenceTest, EveryKeyIsListedOnce) {
  std::set<std::string> seen;
  for (const BenchKey& key : bench_keys())
    EXPECT_TRUE(seen.insert((key.repeated ? "[" + key.section + "]." : key.section + ".") + key.key).second)
        << key.section << "." << key.key;
  EXPECT_GT(seen.size(), 150U);
}

TEST(KeyReferenceTest, AKeyHasItsTypeUnitRangeAndDefault) {
  const std::vector<BenchKey> keys = bench_keys();
  const BenchKey& steps = key_of(keys, "protocol", "steps");
  EXPECT_EQ(steps.type, "integer");
  EXPECT_EQ(steps.range, "4 to 7200");
  EXPECT_EQ(steps.fallback, "72");
  const BenchKey& settle = key_of(keys, "protocol", "settle_s");
  EXPECT_EQ(settle.unit, "s");
  EXPECT_EQ(settle.range, "0 to 86400, `\"auto\"`");
  EXPECT_TRUE(key_of(keys, "accelerometer", "driver").required);
  EXPECT_EQ(key_of(keys, "accelerometer", "full_scale").fallback, "");
  EXPECT_EQ(key_of(keys, "limits", "temperature_min_degc").fallback, "");
  EXPECT_TRUE(key_of(keys, "fault", "kind").repeated);
  EXPECT_THAT(key_of(keys, "fault", "kind").range, HasSubstr("`silence`"));
  EXPECT_FALSE(key_of(keys, "change", "noise").meaning.empty());
}

bool has_numbers(const BenchKey& key) {
  const std::set<std::string> types{"number", "3 numbers", "3 x 3 numbers", "numbers", "uncertainty"};
  return types.contains(key.type);
}

/// A number as a key of this type has it.
std::string value_of(const BenchKey& key, const std::string& number) {
  const std::string three = fmt::format("[{0}, {0}, {0}]", number);
  if (key.type == "3 numbers" || key.type == "numbers") return three;
  if (key.type == "3 x 3 numbers") return fmt::format("[{0}, {0}, {0}]", three);
  return number;
}

/// A bench file of this key alone, in its last line.
std::string only(const BenchKey& key, const std::string& number) {
  std::string text = key.section.starts_with("item.") ? "[[item]]\n" : "";
  if (!key.section.empty())
    text += (key.repeated ? "[[" + key.section + "]]" : "[" + key.section + "]") + "\n";
  return text + key.key + " = " + value_of(key, number) + "\n";
}

std::string problems_of(const std::string& toml) {
  try {
    parse_bench(toml, "bench.toml");
  } catch (const BenchError& error) {
    return error.what();
  }
  return "accepted: " + toml;
}

/// "0 to 100" of a key that may be "auto" as well.
std::string range_of(const BenchKey& key) {
  return key.range.substr(0, key.range.find(", `"));
}

/// The line of the problem reported for this key in the last line of a file; empty: none.
std::string problem_of(const BenchKey& key, const std::string& toml) {
  const std::string text = problems_of(toml);
  const std::string where = fmt::format("line {}, [{}] {}: found ",
                                        std::count(toml.begin(), toml.end(), '\n'), key.section, key.key);
  const std::size_t at = text.find(where);
  return at == std::string::npos ? "" : text.substr(at, text.find('\n', at) - at);
}

TEST(KeyReferenceTest, EveryNumberHasARangeThatRefusesNonsenseByLineAndName) {
  std::size_t numbers = 0;
  for (const BenchKey& key : bench_keys()) {
    if (!has_numbers(key)) continue;
    ++numbers;
    EXPECT_THAT(range_of(key), HasSubstr(" to ")) << key.section << "." << key.key;
    for (const char* nonsense : {"1e308", "-1e308"}) {
      const std::string toml = only(key, nonsense);
      EXPECT_THAT(problem_of(key, toml), HasSubstr("number from " + range_of(key))) << toml;
    }
  }
  EXPECT_GT(numbers, 150U);
}

TEST(KeyReferenceTest, TheUpperEndOfARangeIsInIt) {
  for (const BenchKey& key : bench_keys()) {
    if (!has_numbers(key)) continue;
    const std::string toml = only(key, range_of(key).substr(range_of(key).find(" to ") + 4));
    EXPECT_THAT(problem_of(key, toml), testing::Not(HasSubstr("number from " + range_of(key)))) << toml;
  }
}

}  // namespace
}  // namespace abcal
