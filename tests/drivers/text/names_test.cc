#include "drivers/text/names.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace abcal {
namespace {

using testing::ElementsAre;

enum class Fruit { kApple, kPear, kPlum };
constexpr auto kFruits = names<Fruit>({{Fruit::kPear, "pear"}, {Fruit::kApple, "apple"}});

TEST(NamesTest, ATableGivesTheNameOfAValueAndTheValueOfAName) {
  static_assert(kFruits.of(Fruit::kApple) == "apple");
  static_assert(kFruits.value("pear") == Fruit::kPear);
}

TEST(NamesTest, AValueOrANameThatItDoesNotHaveIsNoOther) {
  EXPECT_EQ(kFruits.of(Fruit::kPlum), "");
  EXPECT_EQ(kFruits.of(Fruit::kPlum, "unknown"), "unknown");
  EXPECT_EQ(kFruits.value("plum"), std::nullopt);
  EXPECT_EQ(kFruits.value("Pear"), std::nullopt);
}

TEST(NamesTest, AllNamesAreInTheOrderOfTheTable) {
  EXPECT_THAT(kFruits.all(), ElementsAre("pear", "apple"));
}

}  // namespace
}  // namespace abcal
