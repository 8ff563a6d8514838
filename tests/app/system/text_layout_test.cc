#include "app/system/text_layout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace abcal {
namespace {

using testing::ElementsAre;

TEST(TextLayoutTest, WidthIsColumnsOfATerminalAndNotBytes) {
  EXPECT_EQ(display_width("Söhne"), 5U);
  EXPECT_EQ(display_width("加速度計"), 8U);
  EXPECT_EQ(display_width("u\u0308"), 1U);  // u and a combining diaeresis
  EXPECT_EQ(display_width("a\xff"), 2U);    // no UTF-8
}

TEST(TextLayoutTest, LinesEndBetweenWords) {
  EXPECT_THAT(lines_of("one two three", 7), ElementsAre("one two", "three"));
  EXPECT_THAT(lines_of("加速 度計", 8), ElementsAre("加速", "度計"));
  EXPECT_THAT(lines_of("", 7), ElementsAre(""));
  EXPECT_EQ(wrapped("one two three", "- ", "  ", 9), "- one two\n  three\n");
}

TEST(TextLayoutTest, ALongWordStaysWholeOrIsBrokenBetweenCharacters) {
  EXPECT_THAT(lines_of("a 0123456789 b", 4), ElementsAre("a", "0123456789", "b"));
  EXPECT_THAT(lines_of("a 0123456789 b", 4, LongWords::kBreak), ElementsAre("a", "0123", "4567", "89 b"));
  EXPECT_THAT(lines_of("加速度計", 5, LongWords::kBreak), ElementsAre("加速", "度計"));
}

}  // namespace
}  // namespace abcal
