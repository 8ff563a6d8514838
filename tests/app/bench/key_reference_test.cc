#include "app/bench/key_reference.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

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

}  // namespace
}  // namespace abcal
