#include "drivers/thorlabs_apt/codec.h"

#include <gtest/gtest.h>

#include "sim/firmware/thorlabs_apt_firmware.h"

namespace abcal::thorlabs_apt {
namespace {

using namespace std::string_literals;
using wire::FrameCheck;

std::string bytes_of(std::initializer_list<int> values) {
  std::string bytes;
  for (const int value : values) bytes.push_back(static_cast<char>(value));
  return bytes;
}

// 0x0491 from bay 1: channel 1, position 204800, velocity 0, homed, tracking, settled, power, enabled.
const std::string& servo_status() {
  static const std::string bytes = bytes_of({0x91, 0x04, 0x0E, 0x00, 0x81, 0x21, 0x01, 0x00, 0x00, 0x20,
                                             0x03, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x34, 0x00, 0x90});
  return bytes;
}
const std::string& moved() {
  static const std::string bytes = bytes_of({0x64, 0x04, 0x01, 0x00, 0x01, 0x50});
  return bytes;
}

// The vectors of thorlabs-apt-protocol.
TEST(ThorlabsAptCodecTest, WritesMessagesAsOtherHostsDo) {
  EXPECT_EQ(short_message(kRequestInfo, 0, 0, kUnit), bytes_of({0x05, 0x00, 0x00, 0x00, 0x50, 0x01}));
  EXPECT_EQ(short_message(kHome, 1, 0, kUnit), bytes_of({0x43, 0x04, 0x01, 0x00, 0x50, 0x01}));
  EXPECT_EQ(short_message(kStop, 1, 2, kUnit), bytes_of({0x65, 0x04, 0x01, 0x02, 0x50, 0x01}));
  EXPECT_EQ(move_absolute(kUnit, 1, 204800),
            bytes_of({0x53, 0x04, 0x06, 0x00, 0xD0, 0x01, 0x01, 0x00, 0x00, 0x20, 0x03, 0x00}));
  EXPECT_EQ(move_absolute(0x21, 1, -1),
            bytes_of({0x53, 0x04, 0x06, 0x00, 0xA1, 0x01, 0x01, 0x00, 0xFF, 0xFF, 0xFF, 0xFF}));
  EXPECT_EQ(set_velocity(kUnit, 1, {0, 2, 256}).substr(0, 8),
            bytes_of({0x13, 0x04, 0x0E, 0x00, 0xD0, 0x01, 0x01, 0x00}));
}

TEST(ThorlabsAptCodecTest, AMessageEndsWhereItsLengthSays) {
  for (std::size_t length = 0; length < servo_status().size(); ++length)
    EXPECT_EQ(check_message(servo_status().substr(0, length)).check, FrameCheck::kNeedMore) << length;
  EXPECT_EQ(check_message(servo_status() + moved()),
            (wire::FrameVerdict{FrameCheck::kComplete, servo_status().size()}));
  EXPECT_EQ(check_message(moved() + "x"), (wire::FrameVerdict{FrameCheck::kComplete, moved().size()}));
}

TEST(ThorlabsAptCodecTest, BytesBeforeAMessageAreAFrameOfTheirOwn) {
  for (const std::string& garbage : {"\xFF"s, "\xFF\xFE\xFD"s, "*IDN?\r\n"s, std::string(40, '\x7F')}) {
    std::string bytes = garbage + servo_status();
    std::string skipped;
    while (!parse_message(bytes)) {
      const auto verdict = check_message(bytes);
      ASSERT_EQ(verdict.check, FrameCheck::kComplete);
      EXPECT_FALSE(parse_message(bytes.substr(0, verdict.length)) && verdict.length < bytes.size());
      skipped += bytes.substr(0, verdict.length);
      bytes.erase(0, verdict.length);
      ASSERT_FALSE(bytes.empty());
    }
    EXPECT_EQ(skipped, garbage);
  }
}

TEST(ThorlabsAptCodecTest, ReadsAStatus) {
  const auto message = parse_message(servo_status());
  ASSERT_TRUE(message);
  EXPECT_EQ(message->id, kServoStatus);
  EXPECT_EQ(message->source, 0x21);
  const auto status = parse_status(*message);
  ASSERT_TRUE(status);
  EXPECT_EQ(status->position, 204800);
  EXPECT_EQ(status->bits, 0x90003400U);
  EXPECT_FALSE(status->moving());
  EXPECT_TRUE(status->homed());
  EXPECT_EQ(status->fault(), "");
  EXPECT_FALSE(parse_velocity(*message));
  EXPECT_FALSE(parse_info(*message));
  EXPECT_FALSE(parse_status(*parse_message(moved())));

  EXPECT_TRUE((Status{0, 1U << 4U}).moving());
  EXPECT_TRUE((Status{0, 1U << 7U}).moving());
  EXPECT_TRUE((Status{0, 1U << 9U}).moving());
  EXPECT_EQ((Status{0, 1U << 14U}).fault(), "motion error: it does not follow");
}

TEST(ThorlabsAptCodecTest, ReadsAnIdentity) {
  std::string data(84, '\0');
  data.replace(0, 4, bytes_of({0x40, 0xE2, 0x01, 0x00}));
  data.replace(4, 6, "K10CR1");
  data.replace(14, 3, bytes_of({3, 2, 1}));
  const auto info = parse_info({.id = kInfo, .source = kUnit, .data = data});
  ASSERT_TRUE(info);
  EXPECT_EQ(info->serial_number, 123456U);
  EXPECT_EQ(info->model, "K10CR1");
  EXPECT_EQ(info->firmware, "1.2.3");
  data[4] = '\x01';
  EXPECT_FALSE(parse_info({.id = kInfo, .source = kUnit, .data = data}));
}

TEST(ThorlabsAptCodecTest, KnowsStagesAndControllers) {
  EXPECT_NEAR(*counts_per_degree("K10CR1"), 136533.333, 1e-3);
  EXPECT_NEAR(*counts_per_degree("DDR100/M"), 9102.222, 1e-3);
  EXPECT_FALSE(counts_per_degree("LTS150"));
  EXPECT_FALSE(counts_per_degree(""));
  ASSERT_TRUE(find_controller("BBD202"));
  EXPECT_TRUE(find_controller("BBD202")->servo);
  ASSERT_TRUE(find_controller("K10CR1"));
  EXPECT_FALSE(find_controller("K10CR1")->servo);
  EXPECT_FALSE(find_controller("BPC303"));
}

TEST(ThorlabsAptCodecTest, ReadsARefusal) {
  const std::string data = bytes_of({0x53, 0x04, 0x04, 0x00}) + "Not now" + std::string(57, '\0');
  const auto refusal = parse_refusal({.id = kRichResponse, .source = kUnit, .data = data});
  ASSERT_TRUE(refusal);
  EXPECT_EQ(refusal->code, 4);
  EXPECT_EQ(refusal->text, "Not now");
}

}  // namespace
}  // namespace abcal::thorlabs_apt
