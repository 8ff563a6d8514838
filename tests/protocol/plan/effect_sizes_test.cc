#include "protocol/plan/effect_sizes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <optional>
#include <string>

namespace abcal {
namespace {

EffectSizes read_back(const std::map<std::string, std::string>& entries) {
  EffectSizes sizes;
  read_effect_sizes(
      [&](const std::string& name, double most) -> std::optional<double> {
        const auto found = entries.find(name);
        if (found == entries.end()) return std::nullopt;
        EXPECT_LE(std::stod(found->second), most) << name;
        return std::stod(found->second);
      },
      [&](const std::string& name) -> std::optional<std::string> {
        const auto found = entries.find(name);
        return found == entries.end() ? std::nullopt : std::optional(found->second);
      },
      sizes);
  return sizes;
}

TEST(EffectSizesTest, EveryEntryIsReadBack) {
  EffectSizes sizes;
  double value = 0.001;
  for (const EffectSizeKey& key : effect_size_keys()) {
    key.set(sizes, value);
    value += 0.001;
  }
  sizes.sources["wobble_urad"] = "certificate 12";
  sizes.shapes["zero_deg"] = Shape::kRectangular;
  const EffectSizes back = read_back(effect_size_entries(sizes));
  value = 0.001;
  for (const EffectSizeKey& key : effect_size_keys()) {
    EXPECT_DOUBLE_EQ(key.get(back), value) << key.key;
    value += 0.001;
  }
  EXPECT_EQ(back.sources, sizes.sources);
  EXPECT_EQ(back.shapes, sizes.shapes);
}

TEST(EffectSizesTest, ADefaultIsNotTakenForAStatement) {
  const EffectSizes sizes = read_back(effect_size_entries({}));
  EXPECT_TRUE(sizes.sources.empty());
  // A default of zero (orthogonality, gain and offset of a voltmeter, cyclic drift, change between runs,
  // eccentricity, and the nine effects of a stage that turns) is no effect of this run.
  EXPECT_EQ(std::ranges::count_if(effect_size_keys(), [](const auto& key) { return key.get({}) == 0.0; }),
            15);
  EXPECT_EQ(unstated_effects(sizes).size(), effect_size_keys().size() - 15);
  EXPECT_EQ(sizes.wobble_urad, 50.0);
}

TEST(EffectSizesTest, ARunAtAConstantRateHasFurtherDefaults) {
  EffectSizes stated;
  stated.low_pass = 0.02;
  stated.sources["low_pass"] = "data sheet";
  const EffectSizes sizes = with_effects_of_motion(stated);
  EXPECT_EQ(sizes.low_pass, 0.02);
  EXPECT_EQ(sizes.position_mm, 30.0);
  EXPECT_EQ(sizes.delay_s, 0.1);
  EXPECT_EQ(read_back(effect_size_entries(sizes)).position_mm, 30.0);
  EXPECT_FALSE(effect_size_entries({}).contains("item_uncertainty.position_mm"));
}

TEST(EffectSizesTest, AnOlderFileStatesItsTolerances) {
  const EffectSizes sizes = read_back({{"tolerances.step_deg", "0.002"}, {"tolerances.wobble_urad", "1"}});
  EXPECT_DOUBLE_EQ(sizes.step.deg(), 0.002);
  EXPECT_EQ(sizes.sources.at("step_deg"), "tolerances");
  EXPECT_EQ(sizes.wobble_urad, 50.0) << "[tolerances] never had it";
}

TEST(EffectSizesTest, AValueWithoutASourceIsStated) {
  const EffectSizes sizes = read_back({{"item_uncertainty.hysteresis", "0"}});
  EXPECT_EQ(sizes.hysteresis, 0.0);
  EXPECT_EQ(sizes.sources.at("hysteresis"), "stated");
}

}  // namespace
}  // namespace abcal
