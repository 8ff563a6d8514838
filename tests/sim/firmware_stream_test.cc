#include "sim/firmware/firmware_stream.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/sim_clock.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

// Message format: field 04 at every 10th tick of 1000 Hz; then resume. A data packet has 20 bytes.
const std::string kFormat("\x75\x65\x0C\x08\x08\x0F\x01\x80\x01\x04\x00\x0A", 12);
const std::string kResume("\x75\x65\x01\x02\x02\x06\xE5\xCB", 8);
constexpr std::size_t kPacket = 20;

class FirmwareStreamTest : public testing::Test {
 protected:
  FirmwareStreamTest() {
    std::string format = kFormat;
    unsigned a = 0;
    unsigned b = 0;
    for (const char c : format) b = (b + (a = (a + static_cast<unsigned char>(c)) % 256)) % 256;
    format.push_back(static_cast<char>(a));
    format.push_back(static_cast<char>(b));
    accelerometer.write(format);
    EXPECT_EQ(accelerometer.read_until(clock.now() + seconds(1)).bytes.size(), 10U);
    accelerometer.write(kResume);
    EXPECT_EQ(accelerometer.read_until(clock.now() + seconds(1)).bytes.size(), 10U);
  }

  SimClock clock;
  std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(BenchTruth{}, clock.now());
  FirmwareStream stage{std::make_shared<PiGcsFirmware>(bench), clock, "simulated stage"};
  FirmwareStream accelerometer{std::make_shared<MipFirmware>(bench), clock, "simulated accelerometer"};
};

TEST_F(FirmwareStreamTest, WaitsUntilTheReplyIsDueAndNoLonger) {
  const Clock::Instant asked = clock.now();
  stage.write("CSV?\n");
  const wire::ReceivedBytes reply = stage.read_until(asked + seconds(7));
  EXPECT_EQ(reply.bytes, "2.0\n");
  EXPECT_EQ(reply.arrival, asked + std::chrono::microseconds(200));
  EXPECT_EQ(clock.now(), reply.arrival);
}

TEST_F(FirmwareStreamTest, IsSilentUntilTheDeadlineWhereNothingComes) {
  const Clock::Instant deadline = clock.now() + milliseconds(123);
  EXPECT_EQ(stage.read_until(deadline).bytes, "");
  EXPECT_EQ(clock.now(), deadline);
  EXPECT_EQ(stage.read_until(deadline - seconds(1)).bytes, "");
  EXPECT_EQ(clock.now(), deadline);
}

TEST_F(FirmwareStreamTest, GivesOnePacketAtEachInstantOfTheGrid) {
  accelerometer.discard_input();
  for (int n = 1; n <= 5; ++n) {
    const wire::ReceivedBytes packet = accelerometer.read_until(clock.now() + seconds(1));
    EXPECT_EQ(packet.bytes.size(), kPacket);
    EXPECT_EQ(packet.arrival, Clock::Instant(milliseconds(10 * n)));
    EXPECT_EQ(clock.now(), packet.arrival);
  }
}

TEST_F(FirmwareStreamTest, WhatOneSendsWhileAnotherIsWaitedForIsThere) {
  accelerometer.discard_input();
  stage.read_until(clock.now() + seconds(2));  // silent: two seconds pass
  const Clock::Instant now = clock.now();
  const wire::ReceivedBytes packets = accelerometer.read_until(now);
  EXPECT_EQ(packets.bytes.size(), 200 * kPacket);
  EXPECT_EQ(packets.arrival, Clock::Instant(milliseconds(2000)));
  EXPECT_EQ(clock.now(), now);
}

TEST_F(FirmwareStreamTest, ReadingsMadeDuringAMoveSeeTheMove) {
  for (const char* command : {"SVO 1 1\n", "FRF 1\n"}) stage.write(command);
  stage.read_until(clock.now() + seconds(1));
  accelerometer.discard_input();
  stage.write("MOV 1 90\n");
  stage.read_until(clock.now() + seconds(10));
  stage.write("MOV 1 0\n");
  const std::string packets = accelerometer.read_until(clock.now()).bytes;
  ASSERT_EQ(packets.size(), 1000 * kPacket);
  // The data: z as big-endian float after header, field header, x and y. Half way it is between 0 and 1.
  const auto z = [&](std::size_t n) { return packets.substr(n * kPacket + 14, 4); };
  EXPECT_NE(z(0), z(200));
  EXPECT_NE(z(200), z(999));
  EXPECT_EQ(z(998), z(999));  // arrived; the move back, commanded later, is not seen yet
}

TEST_F(FirmwareStreamTest, ABoundedBufferDropsTheOldestAndCounts) {
  FirmwareStream small(std::make_shared<MipFirmware>(bench, MipSettings{.streaming_at_power_on = true}),
                       clock, "small", 1000);
  clock.sleep_until(clock.now() + seconds(10));
  const wire::ReceivedBytes received = small.read_until(clock.now());
  EXPECT_LE(received.bytes.size(), 1000U);
  EXPECT_GE(received.bytes.size(), 750U);
  // 100 packets a second of 30 bytes: acceleration and reference time.
  EXPECT_EQ(small.dropped_bytes() + received.bytes.size(), 10U * 100U * 30U);
  EXPECT_EQ(received.arrival, Clock::Instant(seconds(10)));
}

TEST_F(FirmwareStreamTest, AnHoursMeasurementPassesPacketByPacketWithoutDelay) {
  // A measurement with 1000 readings at each of 219 angles, 5 s of settling and 5 s of waiting, at 100 Hz: it
  // must be over at once. 438000 packets.
  std::size_t bytes = 0;
  for (int angle = 0; angle < 219; ++angle) {
    stage.read_until(clock.now() + seconds(10));
    accelerometer.discard_input();
    for (int n = 0; n < 1000; ++n) bytes += accelerometer.read_until(clock.now() + seconds(1)).bytes.size();
  }
  EXPECT_EQ(bytes, 219U * 1000U * kPacket);
}

}  // namespace
}  // namespace abcal::sim
