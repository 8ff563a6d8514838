#include "drivers/text/text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

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

}  // namespace
}  // namespace abcal::pieces
