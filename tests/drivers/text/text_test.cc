#include "drivers/text/text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>

#include "drivers/text/number.h"

namespace abcal::pieces {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

TEST(TextTest, TrimmedTakesBlanksOffTheEndsOnly) {
  EXPECT_EQ(trimmed(" \ta b\r\n"), "a b");
  EXPECT_EQ(trimmed(" \t\r\n"), "");
  EXPECT_EQ(trimmed(""), "");
  EXPECT_EQ(trimmed("\"a\"", "\""), "a");
}

TEST(TextTest, SplitKeepsEmptyParts) {
  EXPECT_THAT(split("a,,b,", ','), ElementsAre("a", "", "b", ""));
  EXPECT_THAT(split("", ','), ElementsAre(""));
}

TEST(TextTest, WordsAreNeverEmpty) {
  EXPECT_THAT(words("  a  b\tc \n"), ElementsAre("a", "b", "c"));
  EXPECT_THAT(words(" "), IsEmpty());
}

TEST(TextTest, LowerChangesLettersOfAsciiOnly) {
  EXPECT_EQ(lower("aB-Z9\xC4"), "ab-z9\xC4");
}

TEST(NumberTest, IsAllOfTheTextOrNone) {
  EXPECT_EQ(number<double>("-1.5e3"), -1500.0);
  EXPECT_EQ(number<int>("1F", 16), 31);
  for (const char* none : {"", " 1", "1 ", "1x", "+1", "--1", "1e999"})
    EXPECT_EQ(number<double>(none), std::nullopt);
  EXPECT_EQ(number<std::uint16_t>("65536"), std::nullopt);
  EXPECT_EQ(number<double>("1e3", std::chars_format::fixed), std::nullopt);
}

TEST(NumberTest, OnePlusSignIsTakenOffButNotThatOfAnotherSign) {
  EXPECT_EQ(without_plus("+1"), "1");
  EXPECT_EQ(without_plus("-1"), "-1");
  EXPECT_EQ(number<int>(without_plus("+-1")), std::nullopt);
  EXPECT_EQ(number<int>(without_plus("++1")), std::nullopt);
}

}  // namespace
}  // namespace abcal::pieces
