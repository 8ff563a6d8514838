#include "drivers/mavlink/codec.h"

#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

namespace abcal::mavlink {
namespace {

std::string from_hex(std::string_view digits) {
  std::string bytes;
  for (std::size_t n = 0; n + 1 < digits.size(); n += 2)
    bytes.push_back(static_cast<char>(std::stoi(std::string(digits.substr(n, 2)), nullptr, 16)));
  return bytes;
}

// Made with node-mavlink 2.3.0.
const std::string kScaled2 =
    from_hex("fd1800000701011a0000e80300000100feff18fc030004000500060007000800c409f5c9");
const std::string kScaled2Cut =
    from_hex("fd1500000801011a0000e80300000100feff18fc0300040005000600070008dbb7");
const std::string kScaled1 = from_hex("fe180901011ae80300000100feff18fc0300040005000600070008000000fb5d");
const std::string kRaw = from_hex("fd0e00000b01011b000040420f00000000000100020018fc577d");
const std::string kHeartbeatFrame = from_hex("fd0900000001010000000000000002030004034ad7");
const std::string kHighres = from_hex(
    "fd3e00000a010169000040420f00000000000000003f000080bec3f51cc100000000000000000000000000000000000000000000"
    "00"
    "0000507d4400000000000000000000c8413f1ea7b1");

std::vector<Frame> frames_of(const std::string& bytes) {
  FrameParser parser;
  parser.feed(bytes);
  std::vector<Frame> frames;
  while (auto frame = parser.next()) frames.push_back(*frame);
  return frames;
}

TEST(MavlinkCodecTest, ReadsScaledImuOfBothVersions) {
  for (const auto& [bytes, sequence, temperature] :
       {std::tuple{kScaled2, 7, 25.0}, {kScaled2Cut, 8, 0.0}, {kScaled1, 9, 0.0}}) {
    const auto frames = frames_of(bytes);
    ASSERT_EQ(frames.size(), 1U);
    EXPECT_TRUE(frames[0].known);
    EXPECT_EQ(frames[0].sequence, sequence);
    EXPECT_EQ(frames[0].size, bytes.size());
    const auto acceleration = decode_acceleration(frames[0]);
    ASSERT_TRUE(acceleration);
    EXPECT_TRUE(
        acceleration->output_mps2.isApprox(Eigen::Vector3d(9.80665e-3, -2 * 9.80665e-3, -9.80665), 1e-12));
    EXPECT_EQ(acceleration->time_us, 1'000'000U);
    EXPECT_EQ(acceleration->temperature_degc.value_or(0.0), temperature);
    EXPECT_FALSE(acceleration->clipped);
  }
}

TEST(MavlinkCodecTest, ReadsHighresImu) {
  const auto frames = frames_of(kHighres);
  ASSERT_EQ(frames.size(), 1U);
  const auto acceleration = decode_acceleration(frames[0]);
  ASSERT_TRUE(acceleration);
  EXPECT_TRUE(acceleration->output_mps2.isApprox(Eigen::Vector3d(0.5, -0.25, -9.81), 1e-6));
  EXPECT_EQ(acceleration->time_us, 1'000'000U);
  EXPECT_EQ(acceleration->temperature_degc, 25.0);
}

TEST(MavlinkCodecTest, AHighresImuWithoutNewAccelerationIsNone) {
  Frame frame = frames_of(kHighres).at(0);
  frame.payload[60] = '\x38';  // Gyroscope only.
  EXPECT_FALSE(decode_acceleration(frame));
}

TEST(MavlinkCodecTest, ReadsAHeartbeat) {
  const auto heartbeat = decode_heartbeat(frames_of(kHeartbeatFrame).at(0));
  ASSERT_TRUE(heartbeat);
  EXPECT_TRUE(heartbeat->is_vehicle());
  EXPECT_EQ(autopilot_name(heartbeat->autopilot), "ArduPilot");
  EXPECT_FALSE(decode_heartbeat(frames_of(our_heartbeat()).at(0))->is_vehicle());
}

TEST(MavlinkCodecTest, FindsFramesHoweverTheyAreSplitAndBehindGarbage) {
  const std::string bytes =
      "\xFD\x03" + kScaled2 + "garbage\xFE" + kHeartbeatFrame + kHighres + kRaw + kScaled1;
  const auto whole = frames_of(bytes);
  ASSERT_EQ(whole.size(), 5U);
  FrameParser parser;
  std::vector<std::uint32_t> ids;
  for (const char c : bytes) {
    parser.feed({&c, 1});
    while (auto frame = parser.next()) ids.push_back(frame->id);
  }
  EXPECT_EQ(ids, (std::vector<std::uint32_t>{26, 0, 105, 27, 26}));
  EXPECT_EQ(parser.skipped_bytes(), 10U);
}

TEST(MavlinkCodecTest, AnySingleWrongByteIsSeen) {
  for (const std::string& sound : {kScaled2, kHighres, kHeartbeatFrame, kScaled1}) {
    for (std::size_t n = 0; n < sound.size(); ++n) {
      std::string wrong = sound;
      wrong[n] = static_cast<char>(wrong[n] ^ 0x10);
      FrameParser parser;
      parser.feed(wrong);
      parser.feed(std::string(300, '\0'));
      while (const auto frame = parser.next()) EXPECT_FALSE(frame->known) << n;
    }
  }
}

TEST(MavlinkCodecTest, AFrameOfAnUnknownKindIsPassedOverWhereOneIsDue) {
  std::string unknown = kHeartbeatFrame;
  unknown[7] = '\xF0';
  const auto frames = frames_of(kScaled2 + unknown + kScaled2Cut);
  ASSERT_EQ(frames.size(), 3U);
  EXPECT_FALSE(frames[1].known);
  EXPECT_EQ(frames[1].id, 240U);
  EXPECT_TRUE(frames[2].known);
  EXPECT_EQ(frames_of(unknown + kScaled2).size(), 1U);
}

TEST(MavlinkCodecTest, AFalseBeginningDoesNotHideWhatIsBehindIt) {
  FrameParser parser;
  parser.feed(kScaled2 + from_hex("fdff0000000101000000") + kHeartbeatFrame);
  ASSERT_TRUE(parser.next());
  EXPECT_FALSE(parser.next());
  const auto behind = parser.next_behind_partial();
  ASSERT_TRUE(behind);
  EXPECT_EQ(behind->id, 0U);
}

TEST(MavlinkCodecTest, ASignedFrameIsReadAndOtherFlagsAreNot) {
  std::string frame = kHeartbeatFrame;
  frame[2] = '\x01';
  const std::uint16_t crc = checksum(std::string_view(frame).substr(1, 18), 50);
  frame[19] = static_cast<char>(crc & 0xFF);
  frame[20] = static_cast<char>(crc >> 8);
  const auto frames = frames_of(frame + std::string(13, '\x55'));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].size, 34U);
  frame[2] = '\x02';
  EXPECT_TRUE(frames_of(frame).empty());
}

TEST(MavlinkCodecTest, WritesCommands) {
  const auto frames = frames_of(command_long(1, 1, kSetMessageInterval, {105.0F, 10000.0F}));
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_TRUE(frames[0].known);
  EXPECT_EQ(frames[0].id, kCommandLong);
  EXPECT_EQ(frames[0].payload.size(), 33U);
  EXPECT_EQ(frames[0].payload.substr(28, 4), from_hex("ff010101"));
  EXPECT_THROW(make_frame(2, 0, kCommandLong, "short"), std::invalid_argument);
  EXPECT_EQ(checksum(std::string_view(kScaled2).substr(1, kScaled2.size() - 3), 170), 0xC9F5);
}

TEST(MavlinkCodecTest, ParametersAreAskedForAndSetByTheirName) {
  FrameParser parser;
  parser.feed(param_request_read(1, 1, "CAL_ACC0_XOFF"));
  parser.feed(param_set(1, 1, "INS_ACCSCAL_X", 0.5F));
  const auto read = parser.next();
  const auto set = parser.next();
  ASSERT_TRUE(read && read->known && read->id == kParamRequestRead);
  EXPECT_EQ(read->payload, std::string("\xFF\xFF\x01\x01") + "CAL_ACC0_XOFF" + std::string(3, '\0'));
  ASSERT_TRUE(set && set->known && set->id == kParamSet);
  EXPECT_EQ(set->payload,
            std::string("\0\0\0\x3F\x01\x01", 6) + "INS_ACCSCAL_X" + std::string(3, '\0') + "\x09");
  EXPECT_THROW((void)param_set(1, 1, "SEVENTEEN_LETTERS", 1.0F), std::invalid_argument);
}

TEST(MavlinkCodecTest, AWholeNumberOfAParameterIsReadAsItsAutopilotSendsIt) {
  const std::string name = std::string("SENS_BOARD_ROT") + std::string(2, '\0');
  const auto value = [&](const std::string& bytes, char type, std::uint8_t autopilot) {
    FrameParser parser;
    parser.feed(make_frame(2, 0, kParamValue, bytes + std::string(4, '\0') + name + type));
    return decode_parameter(parser.next().value(), autopilot).value();
  };
  const std::string minus_one("\xFF\xFF\xFF\xFF", 4);
  EXPECT_EQ(value(minus_one, 6, kPx4).value, -1.0);
  EXPECT_EQ(value(minus_one, 6, kPx4).name, "SENS_BOARD_ROT");
  EXPECT_EQ(value(std::string("\0\0\x80\xBF", 4), 6, kArduPilot).value, -1.0);
  EXPECT_EQ(value(std::string("\0\0\x80\xBF", 4), 9, kPx4).value, -1.0);
}

}  // namespace
}  // namespace abcal::mavlink
