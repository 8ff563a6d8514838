#include "drivers/witmotion/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "tests/drivers/witmotion/reference_decoder.h"

namespace abcal::witmotion {
namespace {

namespace reference = test::witmotion_reference;
using reference::from_hex;
using ::testing::ElementsAre;

std::vector<Frame> parse(std::string_view bytes, std::size_t piece = 1) {
  FrameParser parser;
  std::vector<Frame> found;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto frame = parser.next()) found.push_back(*frame);
  }
  return found;
}

// A WT61PC at rest, from public code: acceleration, angular rate, angle.
const std::string kRecordedAcceleration = from_hex("55 51 ae ff 0c 00 12 08 78 08 f9");
const std::string kRecordedRate = from_hex("55 52 00 00 00 00 00 00 78 08 27");
const std::string kRecordedAngle = from_hex("55 53 43 00 87 01 6d 01 6a 42 8d");

TEST(WitMotionCodecTest, WritesTheCommandsOfTheManual) {
  EXPECT_EQ(write_register(kLock, kUnlock), from_hex("FF AA 69 88 B5"));
  EXPECT_EQ(write_register(kOutputMask, kAccelerationOnly), from_hex("FF AA 02 02 00"));
  EXPECT_EQ(write_register(kRate, 0x0B), from_hex("FF AA 03 0B 00"));
  EXPECT_EQ(read_registers(kVersion), from_hex("FF AA 27 2E 00"));
}

TEST(WitMotionCodecTest, DecodesTheRecordedFrames) {
  const std::string bytes = kRecordedAcceleration + kRecordedRate + kRecordedAngle;
  for (const std::size_t piece : {std::size_t{1}, std::size_t{7}, bytes.size()}) {
    const auto frames = parse(bytes, piece);
    ASSERT_EQ(frames.size(), 3U);
    const auto acceleration = decode_acceleration(frames[0]);
    ASSERT_TRUE(acceleration);
    EXPECT_NEAR(acceleration->output_g.x(), -0.0400,
                5e-5);  // half of the last digit of docs/protocols/witmotion.md
    EXPECT_NEAR(acceleration->output_g.y(), 0.0059, 5e-5);
    EXPECT_NEAR(acceleration->output_g.z(), 1.0088, 5e-5);
    EXPECT_EQ(acceleration->output_g, Eigen::Vector3d(-82, 12, 2066) * (16.0 / 32768.0));
    EXPECT_DOUBLE_EQ(acceleration->temperature_degc, 21.68);
    EXPECT_FALSE(acceleration->clipped);
    EXPECT_FALSE(decode_acceleration(frames[1]));
    EXPECT_FALSE(decode_acceleration(frames[2]));
    EXPECT_EQ(frames[2].type, kAngle);
    EXPECT_EQ(frames[2].words[3], 0x426A);
  }
}

TEST(WitMotionCodecTest, SaysThatAWordIsAtTheEndOfItsRange) {
  const auto clipped = [](int x, int y, int z) {
    return decode_acceleration(parse(reference::acceleration(x, y, z)).at(0))->clipped;
  };
  EXPECT_FALSE(clipped(32766, -32767, 0));
  EXPECT_TRUE(clipped(32767, 0, 0));
  EXPECT_TRUE(clipped(0, -32768, 0));
  EXPECT_TRUE(clipped(0, 0, 32767));
  const auto frame = parse(reference::acceleration(-32768, 32767, 1, -1250)).at(0);
  EXPECT_EQ(decode_acceleration(frame)->output_g, Eigen::Vector3d(-16.0, 16.0 - kStepG, kStepG));
  EXPECT_EQ(decode_acceleration(frame)->temperature_degc, -12.5);
}

TEST(WitMotionCodecTest, RejectsEverySingleDamagedByteOfAFrame) {
  const std::string good = reference::acceleration(1, 2, 3);
  for (const std::string& frame :
       {kRecordedAcceleration, kRecordedRate, kRecordedAngle, reference::frame(0x5F, {17202, 0, 0, 0})}) {
    for (std::size_t at = 0; at < frame.size(); ++at) {
      for (unsigned change = 1; change < 256; ++change) {
        std::string damaged = frame;
        damaged[at] = static_cast<char>(static_cast<unsigned char>(damaged[at]) ^ change);
        const auto found = parse(damaged + good, 100);
        ASSERT_EQ(found.size(), 1U) << "byte " << at << " changed by " << change;
        ASSERT_THAT(found.front().words, ElementsAre(1, 2, 3, 2500));
      }
    }
  }
}

TEST(WitMotionCodecTest, FindsFramesInGarbageByteByByte) {
  const std::string garbage = from_hex("51 55 00 55 55 51 ff aa 27 55 5f 01 55");
  const std::string bytes = garbage + kRecordedAcceleration + garbage + kRecordedRate + kRecordedAngle +
                            garbage + std::string(10, '\0');
  const auto expected = reference::decode(bytes);
  ASSERT_EQ(expected.frames.size(), 3U);
  EXPECT_GT(expected.bad_frames, 0U);
  for (std::size_t piece = 1; piece < 40; ++piece) {
    FrameParser parser;
    std::size_t found = 0;
    for (std::size_t at = 0; at < bytes.size(); at += piece) {
      parser.feed(std::string_view(bytes).substr(at, piece));
      while (parser.next()) ++found;
    }
    EXPECT_EQ(found, 3U) << piece;
    EXPECT_EQ(parser.bad_frames(), expected.bad_frames);
    EXPECT_EQ(parser.skipped_bytes(), bytes.size() - 33U);
    EXPECT_FALSE(parser.has_partial());
  }
}

TEST(WitMotionCodecTest, NeverJoinsWhatAGapSeparates) {
  FrameParser parser;
  parser.feed(kRecordedAcceleration.substr(0, 5));
  EXPECT_FALSE(parser.next());
  EXPECT_TRUE(parser.has_partial());
  parser.lose_track();
  EXPECT_FALSE(parser.has_partial());
  parser.feed(kRecordedAcceleration.substr(5) + kRecordedAngle);
  EXPECT_EQ(parser.next()->type, kAngle);
  EXPECT_EQ(parser.skipped_bytes(), 11U);
}

TEST(WitMotionCodecTest, KnowsTheCodesOfTheManual) {
  EXPECT_EQ(rate_code(1.0), 0x03);
  EXPECT_EQ(rate_code(10.0), 0x06);
  EXPECT_EQ(rate_code(20.0), 0x07);
  EXPECT_EQ(rate_code(50.0), 0x08);
  EXPECT_EQ(rate_code(100.0), 0x09);
  EXPECT_EQ(rate_code(200.0), 0x0B);
  EXPECT_EQ(rate_code(99.0), std::nullopt);
  EXPECT_EQ(nearest_rate_hz(99.0), 100.0);
  EXPECT_EQ(nearest_rate_hz(1e6), 200.0);
  EXPECT_EQ(nearest_rate_hz(0.1), 1.0);
  EXPECT_EQ(baud_rate(2), 9600.0);
  EXPECT_EQ(baud_rate(6), 115200.0);
  EXPECT_EQ(baud_rate(0), std::nullopt);
  EXPECT_EQ(baud_rate(10), std::nullopt);
  EXPECT_EQ(range_g(0), 2.0);
  EXPECT_EQ(range_g(3), 16.0);
  EXPECT_EQ(range_g(4), std::nullopt);
}

}  // namespace
}  // namespace abcal::witmotion
