#include "sim/firmware/witmotion_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::ElementsAre;
using testing::IsEmpty;
using namespace std::string_view_literals;

constexpr std::string_view kUnlock = "\xFF\xAA\x69\x88\xB5"sv;
constexpr std::string_view kSave = "\xFF\xAA\x00\x00\x00"sv;

struct Frame {
  int type = 0;
  std::array<int, 4> words{};
};

/// Reads whole frames; anything else fails the test.
std::vector<Frame> frames_of(const std::string& bytes) {
  std::vector<Frame> frames;
  EXPECT_EQ(bytes.size() % 11, 0U);
  for (std::size_t at = 0; at + 11 <= bytes.size(); at += 11) {
    const auto byte = [&](std::size_t n) { return static_cast<unsigned char>(bytes[at + n]); };
    EXPECT_EQ(byte(0), 0x55);
    int sum = 0;
    for (std::size_t n = 0; n < 10; ++n) sum += byte(n);
    EXPECT_EQ(byte(10), sum % 256);
    Frame frame{byte(1), {}};
    for (std::size_t n = 0; n < 4; ++n) {
      const int word = byte(2 + 2 * n) + 256 * byte(3 + 2 * n);
      frame.words[n] = word > 32767 ? word - 65536 : word;
    }
    frames.push_back(frame);
  }
  return frames;
}

class WitMotionFirmwareTest : public testing::Test {
 protected:
  explicit WitMotionFirmwareTest(WitMotionSettings settings = {}, BenchTruth truth = {})
      : bench(std::make_shared<SimBench>(std::move(truth))), firmware(bench, settings), host(firmware) {}

  void send(std::string_view bytes) { host.send(bytes); }
  void write(unsigned reg, unsigned value) {
    send(kUnlock);
    send(std::string{'\xFF', '\xAA', static_cast<char>(reg), static_cast<char>(value & 0xFF),
                     static_cast<char>(value >> 8)});
  }
  /// The four registers from this one, between what streams.
  std::array<int, 4> read(unsigned reg) {
    send(std::string{'\xFF', '\xAA', '\x27', static_cast<char>(reg), '\0'});
    for (const Frame& frame : frames_of(host.listen(milliseconds(1))))
      if (frame.type == 0x5F) return frame.words;
    ADD_FAILURE() << "no reply";
    return {};
  }

  std::shared_ptr<SimBench> bench;
  WitMotionFirmware firmware;
  FirmwareHost host;
};

TEST_F(WitMotionFirmwareTest, StreamsFromPowerOnWithTheWorldsOutput) {
  const auto frames = frames_of(host.listen(seconds(1)));
  ASSERT_EQ(frames.size(), 40U);  // 10 Hz, four frames
  for (std::size_t n = 0; n < frames.size(); ++n) EXPECT_EQ(frames[n].type, 0x51 + static_cast<int>(n % 4));
  EXPECT_THAT(frames[0].words, ElementsAre(0, 0, 2048, 2300));  // 1 g, 23 degC
  EXPECT_EQ(frames[2].words[3], 17202);
}

TEST_F(WitMotionFirmwareTest, TheOutputFollowsTheWorldAndClips) {
  bench->move(StageAxis::kX, Angle::degrees(90.0), host.clock().now());
  host.listen(seconds(10));
  EXPECT_THAT(frames_of(host.listen(milliseconds(100)))[0].words, ElementsAre(0, 2048, 0, 2300));
  BenchTruth truth;
  truth.sensitivity_matrix *= 20.0;
  WitMotionFirmware strong(std::make_shared<SimBench>(truth));
  FirmwareHost other(strong);
  EXPECT_EQ(frames_of(other.listen(milliseconds(100)))[0].words[2], 32767);
}

TEST_F(WitMotionFirmwareTest, RatesAndFramesAreAsConfigured) {
  write(0x02, 0x02);
  for (const auto& [code, count] :
       {std::pair{0x03U, 1U}, {0x06U, 10U}, {0x07U, 20U}, {0x08U, 50U}, {0x09U, 100U}, {0x0BU, 200U}}) {
    write(0x03, code);
    const auto frames = frames_of(host.listen(seconds(10)));
    EXPECT_EQ(frames.size(), 10 * count) << code;
    for (const Frame& frame : frames) EXPECT_EQ(frame.type, 0x51);
  }
  write(0x03, 0x01);
  EXPECT_EQ(frames_of(host.listen(seconds(10))).size(), 2U);  // 0.2 Hz
  write(0x03, 0x0C);
  EXPECT_EQ(frames_of(host.listen(seconds(10))).size(), 1U);  // once
}

TEST_F(WitMotionFirmwareTest, NothingIsTakenUnlessItIsUnlocked) {
  send("\xFF\xAA\x03\x09\x00"sv);
  EXPECT_EQ(read(0x03)[0], 0x06);
  send("\xFF\xAA\x69\x88\xB4"sv);  // the wrong key
  send("\xFF\xAA\x03\x09\x00"sv);
  EXPECT_EQ(read(0x03)[0], 0x06);
  send(kUnlock);
  host.listen(seconds(11));
  send("\xFF\xAA\x03\x09\x00"sv);
  EXPECT_EQ(read(0x03)[0], 0x06) << "it has locked itself again";
  write(0x03, 0x09);
  EXPECT_EQ(read(0x03)[0], 0x09);
}

TEST_F(WitMotionFirmwareTest, ValuesItDoesNotHaveAreNotTaken) {
  write(0x03, 0x55);
  EXPECT_EQ(read(0x03)[0], 0x06);
  write(0x04, 0x77);
  EXPECT_EQ(read(0x04)[0], 6);
  write(0x2E, 1);
  EXPECT_EQ(read(0x2E)[0], 17202);
  write(0x34, 1);
  EXPECT_EQ(read(0x34)[2], 2048);
}

TEST_F(WitMotionFirmwareTest, RegistersAreReadFourAtATime) {
  EXPECT_THAT(read(0x02), ElementsAre(0x1E, 0x06, 6, 0));
  EXPECT_THAT(read(0x34), ElementsAre(0, 0, 2048, 0));
  EXPECT_EQ(read(0x40)[0], 2300);
}

TEST_F(WitMotionFirmwareTest, SettingsAreSavedAndRestored) {
  write(0x02, 0x02);
  write(0x00, 0xFF);  // restart
  EXPECT_EQ(read(0x02)[0], 0x1E);
  write(0x02, 0x02);
  send(kSave);
  write(0x00, 0xFF);
  EXPECT_EQ(read(0x02)[0], 0x02);
  write(0x00, 0x01);  // as from the factory
  EXPECT_EQ(read(0x02)[0], 0x1E);
}

TEST_F(WitMotionFirmwareTest, CommandsMayBeSplitAndComeAfterGarbage) {
  send("\x55\xFFgarbage\xFF");
  send(kUnlock.substr(0, 3));
  send(kUnlock.substr(3));
  send("\xFF\xAA\x02"sv);
  send("\x02\x00"sv);
  EXPECT_EQ(read(0x02)[0], 0x02);
}

TEST_F(WitMotionFirmwareTest, RepliesComeBetweenTheStream) {
  write(0x03, 0x0B);
  host.listen(milliseconds(20));
  send("\xFF\xAA\x27\x02\x00"sv);
  const auto frames = frames_of(host.listen(milliseconds(20)));
  EXPECT_GE(frames.size(), 13U);
  EXPECT_EQ(std::count_if(frames.begin(), frames.end(), [](const Frame& f) { return f.type == 0x5F; }), 1);
}

TEST(WitMotionFirmwareSettingsTest, SettingsItDoesNotHaveAreRefused) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  EXPECT_THROW(WitMotionFirmware(bench, {.baud = 1}), std::invalid_argument);
  EXPECT_THROW(WitMotionFirmware(bench, {.rate_code = 0x55}), std::invalid_argument);
}

TEST(WitMotionFirmwareSettingsTest, AnOlderModuleNeedsNoUnlocking) {
  WitMotionFirmware firmware(std::make_shared<SimBench>(BenchTruth{}), {.needs_unlock = false});
  FirmwareHost host(firmware);
  host.send("\xFF\xAA\x02\x02\x00"sv);
  EXPECT_EQ(frames_of(host.listen(seconds(1))).size(), 10U);
}

TEST(WitMotionFirmwareSettingsTest, AFaultyWorldMakesNoReadings) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  bench->inject({.kind = FaultKind::kNoOutput});
  WitMotionFirmware firmware(bench);
  FirmwareHost host(firmware);
  EXPECT_THAT(host.listen(seconds(1)), IsEmpty());
}

TEST_F(WitMotionFirmwareTest, GyroMagnetometerAndAnglesFollowTheStage) {
  bench->move(StageAxis::kX, Angle::degrees(45.0), host.clock().now());
  host.listen(seconds(1));
  // 20 deg/s of 2000.
  EXPECT_EQ(read(0x37)[0], 328);
  host.listen(seconds(5));
  EXPECT_EQ(read(0x37)[0], 0);
  EXPECT_EQ(read(0x3D)[2], 16384) << "yaw: x points north, a quarter of a turn from east";
  EXPECT_EQ(read(0x3D)[0], 8192) << "roll of 45 degrees";
  const auto frames = frames_of(host.listen(milliseconds(100)));
  ASSERT_EQ(frames.size(), 4U);
  EXPECT_EQ(frames[1].type, 0x52);
  EXPECT_EQ(frames[1].words[0], 0);
  EXPECT_EQ(frames[2].type, 0x53);
  EXPECT_EQ(frames[2].words[0], 8192);
  EXPECT_EQ(frames[3].type, 0x54);
  EXPECT_EQ(frames[3].words[0], 410) << "0.25 of 20 gauss";
}

TEST_F(WitMotionFirmwareTest, WithoutPowerItForgetsWhatWasNotSaved) {
  write(0x03, 0x09);  // 100 Hz
  write(0x04, 2);     // 9600 Bd
  EXPECT_EQ(firmware.line_speed(), 9600U);
  host.listen(milliseconds(105));
  EXPECT_EQ(frames_of(host.listen(seconds(1))).size(), 4U * 100U);
  firmware.power(false, host.clock().now());
  firmware.power(true, host.clock().now());
  EXPECT_EQ(firmware.line_speed(), 115200U);
  EXPECT_EQ(frames_of(host.listen(seconds(1))).size(), 4U * 10U);
}

}  // namespace
}  // namespace abcal::sim
