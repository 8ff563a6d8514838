#include "drivers/watlow_f4/codec.h"

#include <gtest/gtest.h>

namespace abcal::watlow_f4 {
namespace {

std::string hex(std::initializer_list<int> bytes) {
  std::string text;
  for (const int each : bytes) text.push_back(static_cast<char>(each));
  return text;
}

// The bytes of docs/protocols/watlow_f4.md, two of them seen from a host of the chamber's maker.
TEST(WatlowCodecTest, RequestsAreThoseOfTheHosts) {
  EXPECT_EQ(frame(Framing::kRtu, 1, 0, read_registers(606, 1)), hex({1, 3, 2, 0x5E, 0, 1, 0xE4, 0x60}));
  EXPECT_EQ(frame(Framing::kRtu, 1, 0, read_registers(100, 1)), hex({1, 3, 0, 0x64, 0, 1, 0xC5, 0xD5}));
  EXPECT_EQ(frame(Framing::kRtu, 1, 0, write_register(300, *raw_of(-40.0, 1))),
            hex({1, 6, 1, 0x2C, 0xFE, 0x70, 8, 0x7B}));
  EXPECT_EQ(frame(Framing::kRtu, 1, 0, write_register(2000, 1)), hex({1, 6, 7, 0xD0, 0, 1, 0x48, 0x87}));
  EXPECT_EQ(frame(Framing::kTcp, 1, 0, read_registers(2820, 2)),
            hex({0, 0, 0, 0, 0, 6, 1, 3, 0x0B, 4, 0, 2}));
  EXPECT_EQ(frame(Framing::kTcp, 1, 0, write_registers(2782, registers_of(-40.0F))),
            hex({0, 0, 0, 0, 0, 0x0B, 1, 0x10, 0x0A, 0xDE, 0, 2, 4, 0, 0, 0xC2, 0x20}));
}

TEST(WatlowCodecTest, RepliesAreRead) {
  const auto decimals = parse_reply(Framing::kRtu, hex({1, 3, 2, 0, 1, 0x79, 0x84}));
  ASSERT_TRUE(decimals);
  EXPECT_EQ(decimals->registers, std::vector<std::uint16_t>{1});
  const auto air = parse_reply(Framing::kRtu, hex({1, 3, 2, 0, 0xEA, 0x39, 0xCB}));
  ASSERT_TRUE(air);
  EXPECT_DOUBLE_EQ(*decimal_of(air->registers[0], 1), 23.4);
  const auto refused = parse_reply(Framing::kRtu, hex({1, 0x86, 3, 2, 0x61}));
  ASSERT_TRUE(refused);
  EXPECT_EQ(refused->exception, 3);
  EXPECT_EQ(refused->function, 6);
  const auto number = parse_reply(Framing::kTcp, hex({0, 1, 0, 0, 0, 7, 1, 3, 4, 0x33, 0x33, 0x41, 0xBB}));
  ASSERT_TRUE(number);
  EXPECT_EQ(number->transaction, 1);
  EXPECT_FLOAT_EQ(float_of(number->registers[0], number->registers[1]), 23.4F);
}

TEST(WatlowCodecTest, NoSingleByteMayBeChanged) {
  const std::string good = hex({1, 3, 2, 0, 0xEA, 0x39, 0xCB});
  for (std::size_t at = 0; at < good.size(); ++at) {
    for (int bit = 0; bit < 8; ++bit) {
      std::string bad = good;
      bad[at] = static_cast<char>(bad[at] ^ (1 << bit));
      const auto reply = parse_reply(Framing::kRtu, bad);
      EXPECT_FALSE(reply) << at << ' ' << bit;
    }
  }
  for (std::size_t size = 0; size < good.size(); ++size)
    EXPECT_EQ(check_reply(Framing::kRtu, good.substr(0, size)).check, wire::FrameCheck::kNeedMore) << size;
}

TEST(WatlowCodecTest, NumbersThatSayNoValueAreNone) {
  EXPECT_FALSE(decimal_of(static_cast<std::uint16_t>(-32000), 1));
  EXPECT_FALSE(decimal_of(static_cast<std::uint16_t>(-32002), 0));
  EXPECT_DOUBLE_EQ(*decimal_of(static_cast<std::uint16_t>(-4000), 2), -40.0);
  EXPECT_FALSE(raw_of(400.0, 2));
  EXPECT_EQ(text_of({'F', '4', 'T', '1', 0, 'x'}), "F4T1");
}

}  // namespace
}  // namespace abcal::watlow_f4
