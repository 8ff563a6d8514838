#include "sim/serial_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr Clock::Instant kBegin{};

TEST(SerialLineTest, AByteTakesTenBits) {
  SerialLine line;
  line.send("1234567890", 1000, std::nullopt, kBegin);  // 10 ms each
  EXPECT_EQ(line.arrived(kBegin + milliseconds(9)), "");
  EXPECT_EQ(line.arrived(kBegin + milliseconds(10)), "1");
  EXPECT_EQ(line.arrived(kBegin + milliseconds(39)), "23");
  EXPECT_EQ(line.under_way(), 7U);
  EXPECT_EQ(line.arrived(kBegin + seconds(1)), "4567890");
  EXPECT_EQ(line.next_due(), std::nullopt);
}

TEST(SerialLineTest, BytesComeOneAfterTheOther) {
  SerialLine line;
  line.send("aa", 1000, std::nullopt, kBegin);
  line.send("bb", 1000, std::nullopt, kBegin + milliseconds(5));
  EXPECT_EQ(line.arrived(kBegin + milliseconds(30)), "aab");
  EXPECT_EQ(line.next_due(), kBegin + milliseconds(40));
  EXPECT_EQ(line.arrived(kBegin + milliseconds(40)), "b");
  line.send("c", 1000, std::nullopt, kBegin + seconds(1));
  EXPECT_EQ(line.next_due(), kBegin + seconds(1) + milliseconds(10)) << "an idle line begins at once";
}

TEST(SerialLineTest, ALineCarriesATenthOfItsSpeedInBytes) {
  SerialLine line;
  line.send(std::string(100000, 'x'), 115200, 115200, kBegin);
  EXPECT_EQ(line.arrived(kBegin + seconds(1)).size(), 11520U);
  EXPECT_NEAR(to_seconds(line.next_due().value() - kBegin), 1.0 + 16.0 / 11520.0, 1e-8)
      << "a FIFO of 16 bytes";
}

TEST(SerialLineTest, AnotherSpeedAtTheOtherEndMakesNoise) {
  SerialLine line;
  const std::string text = "$VNRRG,01*72\r\n";
  line.send(text, 115200, 921600, kBegin);
  const std::string fast = line.arrived(kBegin + seconds(1));
  EXPECT_EQ(fast.size(), 8 * text.size());
  line.send(text, 115200, 9600, kBegin + seconds(1));
  const std::string slow = line.arrived(kBegin + seconds(2));
  EXPECT_EQ(slow.size(), 2U);
  for (const std::string& noise : {fast, slow})
    EXPECT_TRUE(std::all_of(noise.begin(), noise.end(), [](char c) { return (c & 0x80) != 0; }));
  line.send(text, 115200, 112500, kBegin + seconds(2));
  EXPECT_EQ(line.arrived(kBegin + seconds(3)), text) << "2 % are borne";
}

}  // namespace
}  // namespace abcal::sim
