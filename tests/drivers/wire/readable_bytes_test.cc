#include "drivers/wire/readable_bytes.h"

#include <gtest/gtest.h>

#include <string_view>

namespace abcal::wire {
namespace {

TEST(ReadableBytesTest, ShowsEveryByte) {
  constexpr std::string_view kBytes("A~ \x00\x7F\r\xFF", 7);
  EXPECT_EQ(bytes_in_hex(kBytes), "41 7E 20 00 7F 0D FF");
  EXPECT_EQ(bytes_as_text(kBytes), "A~ \\x00\\x7F\\x0D\\xFF");
  EXPECT_EQ(bytes_in_hex(""), "");
  EXPECT_EQ(bytes_as_text(""), "");
}

}  // namespace
}  // namespace abcal::wire
