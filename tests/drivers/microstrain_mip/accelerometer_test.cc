#include "drivers/microstrain_mip/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <random>

#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/microstrain_mip/fake_mip_device.h"
#include "tests/drivers/microstrain_mip/reference_decoder.h"
#include "tests/support/accelerometer_bench.h"
#include "tests/support/error_of.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::data_packet;
using test::error_of;
using test::FakeMipDevice;
using test::sequences;
using test::WaitingClock;
using ::testing::AllOf;
using ::testing::HasSubstr;
namespace reference = test::mip_reference;

// Twice the reply deadline of the SDK's rule: 2 s and one packet of 261 bytes at 115200 baud times 1.5.
constexpr double kTwoTries = 2.0 * (2.0 + 1.5 * 261.0 / 11520.0);

/// A driver with its scripted device.
struct Bench : test::AccelerometerBench<MipAccelerometer, FakeMipDevice, WaitingClock> {
  explicit Bench(const FakeMipDevice::Script& script = {}, const AccelerometerSettings& settings = {})
      : AccelerometerBench(settings, script) {}
};

std::string hex(std::string_view bytes) {
  constexpr std::string_view kDigits = "0123456789ABCDEF";
  std::string text;
  for (const char byte : bytes) {
    const auto value = static_cast<unsigned char>(byte);
    text += kDigits[value / 16];
    text += kDigits[value % 16];
  }
  return text;
}

constexpr std::uint64_t kPeriodNs = 10'000'000;  // 100 Hz

FakeMipDevice::Script legacy_script() {
  FakeMipDevice::Script script;
  script.descriptors = {0x0101, 0x0102, 0x0103, 0x0104, 0x0106, 0x0C06,
                        0x0C08, 0x8004, 0x8005, 0x8012, 0x8101, 0x8201};
  script.base_rate_hz = 500;
  script.options = "5g, 300d/s      ";
  return script;
}

TEST(MipAccelerometerTest, IdentifiesAModernDevice) {
  Bench bench;
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.maker, "MicroStrain");
  EXPECT_EQ(info.model, "3DM-GX5-25");
  EXPECT_EQ(info.serial_number, "6253.12345");
  EXPECT_EQ(info.firmware, "1103");
  EXPECT_EQ(info.output_unit, "g");
  EXPECT_EQ(info.full_scale, 8.0);
  EXPECT_EQ(info.rate_hz, 100.0);
  EXPECT_EQ(hex(bench.port->commands.front()), "756501020202E1C7") << "idle comes first";
  EXPECT_FALSE(bench.port->was_sent(0x0C, 0x0F)) << "identify() changes nothing";
  EXPECT_FALSE(bench.port->was_sent(0x01, 0x06));
}

TEST(MipAccelerometerTest, IdentifiesALegacyDeviceAndItsRealRate) {
  AccelerometerSettings settings;
  settings.rate_hz = 120.0;
  Bench bench(legacy_script(), settings);
  const AccelerometerInfo info = bench.accelerometer->identify();
  EXPECT_EQ(info.rate_hz, 125.0);  // 500 / 4; 500 / 5 = 100 is farther.
  EXPECT_EQ(info.full_scale, 5.0);
}

TEST(MipAccelerometerTest, PutsTheFullScaleOfTheBenchFileFirst) {
  AccelerometerSettings settings;
  settings.full_scale = 2.0;
  EXPECT_EQ(Bench({}, settings).accelerometer->identify().full_scale, 2.0);
  FakeMipDevice::Script script;
  script.options = "none            ";
  EXPECT_EQ(Bench(script).accelerometer->identify().full_scale, std::nullopt);
}

TEST(MipAccelerometerTest, ConfiguresAModernDevice) {
  Bench bench;
  bench.accelerometer->start();
  std::vector<std::string> commands;
  for (const std::string& command : bench.port->commands)
    commands.push_back(hex(command.substr(4, command.size() - 6)));
  EXPECT_THAT(commands, ::testing::ElementsAre("0202", "0203", "0204", "030E80",
                                               // D5, 04, 18 at 1000/10, 14 at 1000/1000: once a second
                                               "110F018004D5000A04000A18000A1403E8",
                                               "0511018001",  // stream 80 on
                                               "0206"));
}

TEST(MipAccelerometerTest, ConfiguresALegacyDeviceAndSwitchesItsOtherStreamsOff) {
  FakeMipDevice::Script script = legacy_script();
  script.descriptors.push_back(0x0C11);
  Bench bench(script);
  bench.accelerometer->start();
  std::vector<std::string> commands;
  for (const std::string& command : bench.port->commands)
    commands.push_back(hex(command.substr(4, command.size() - 6)));
  EXPECT_THAT(commands, ::testing::ElementsAre("0202", "0203", "0204", "0206", "0A080102120005040005",
                                               "0511010200", "0511010300", "0511010101", "0206"));
}

TEST(MipAccelerometerTest, AsksForMoreDescriptorsWhereTheDeviceHasThem) {
  FakeMipDevice::Script script;
  script.descriptors = {0x0102, 0x0103, 0x0104, 0x0106, 0x0107, 0x0C0E, 0x0C0F};
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x01 || descriptor != 0x07) return false;
    device.send(FakeMipDevice::answer(0x01, 0x07, 0, 0x86, "\x80\x04\xFF\xD5"), milliseconds(1));
    return true;
  };
  Bench bench(script);
  bench.accelerometer->start();
  EXPECT_EQ(hex(bench.port->commands[5].substr(4, 11)), "0B0F018002D5000A04000A");
}

TEST(MipAccelerometerTest, RefusesARateThatNoDecimationGives) {
  AccelerometerSettings settings;
  settings.rate_hz = 400.0;
  Bench bench({}, settings);
  EXPECT_EQ(bench.accelerometer->identify().rate_hz, 333.0 + 1.0 / 3.0);  // nearer than 500
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("rate_hz is 400"), HasSubstr("1000"), HasSubstr("333.333")));
  EXPECT_FALSE(bench.port->was_sent(0x0C, 0x0F));
  for (const double rate_hz : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    settings.rate_hz = rate_hz;
    EXPECT_THROW(Bench({}, settings), std::invalid_argument) << rate_hz;
  }
}

TEST(MipAccelerometerTest, AcceptsARateWithinOnePercent) {
  AccelerometerSettings settings;
  settings.rate_hz = 143.5;  // 1000 / 7 = 142.857: 0.45 % off
  Bench bench({}, settings);
  bench.accelerometer->start();
  EXPECT_DOUBLE_EQ(bench.accelerometer->identify().rate_hz, 1000.0 / 7.0);
}

TEST(MipAccelerometerTest, RefusesAStreamThatTheLinkCannotCarry) {
  AccelerometerSettings settings;
  settings.rate_hz = 1000.0;
  settings.link_bytes_per_s = 11520.0;
  Bench bench({}, settings);
  // 6 of packet, 10 of D5, 14 of 04, 4 of 18: 34 bytes a reading, and 14 a second of 14.
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
              AllOf(HasSubstr("34014 bytes/s"), HasSubstr("11520"), HasSubstr("lower rate_hz to 338")));
  settings.link_bytes_per_s = 92160.0;
  EXPECT_NO_THROW(Bench({}, settings).accelerometer->start());
}

TEST(MipAccelerometerTest, GivesReadingsWithTemperatureAndOverRange) {
  Bench bench;
  bench.accelerometer->start();
  const std::string temperature = reference::field_bytes(
      0x14, reference::float_bytes(20) + reference::float_bytes(30) + reference::float_bytes(25));
  bench.port->send(data_packet(kPeriodNs, 0.25F, -0.5F, 1.0F,
                               reference::field_bytes(0x18, reference::bytes_of(0x0770, 2))));
  bench.port->send(data_packet(2 * kPeriodNs, 0, 0, 1,
                               reference::field_bytes(0x18, reference::bytes_of(2, 2)) + temperature));
  bench.port->send(data_packet(3 * kPeriodNs, 0, 0, 1), milliseconds(9'999));
  bench.port->send(data_packet(4 * kPeriodNs, 0, 0, 1), milliseconds(10'001));
  const Clock::Instant began = bench.clock.now();
  const auto readings = bench.read_all(seconds(11));
  ASSERT_EQ(readings.size(), 4U);
  EXPECT_EQ(readings[0].output, Eigen::Vector3d(0.25, -0.5, 1.0));
  EXPECT_FALSE(readings[0].over_range) << "a gyroscope out of range is none of ours";
  EXPECT_FALSE(readings[0].temperature_degc);
  EXPECT_EQ(readings[0].arrival, began);
  EXPECT_TRUE(readings[1].over_range);
  EXPECT_EQ(readings[1].temperature_degc, 25.0);
  EXPECT_EQ(readings[2].temperature_degc, 25.0) << "held for 10 s";
  EXPECT_EQ(readings[2].arrival, began + milliseconds(9'999));
  EXPECT_FALSE(readings[3].temperature_degc) << "too old";
  EXPECT_THAT(sequences(readings), ::testing::ElementsAre(0, 1, 2, 3));
  EXPECT_EQ(bench.accelerometer->health().readings, 4U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(MipAccelerometerTest, ReturnsNothingAtTheDeadline) {
  Bench bench;
  bench.accelerometer->start();
  const Clock::Instant deadline = bench.clock.now() + milliseconds(250);
  EXPECT_FALSE(bench.accelerometer->next(deadline));
  EXPECT_EQ(bench.clock.now(), deadline);
  EXPECT_FALSE(bench.accelerometer->next(deadline - seconds(1))) << "a deadline that has passed";
  EXPECT_EQ(bench.clock.now(), deadline);
}

TEST(MipAccelerometerTest, PassesNanOn) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send(data_packet(1, std::numeric_limits<float>::quiet_NaN(), 0, 1));
  const auto readings = bench.read_all();
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_TRUE(std::isnan(readings[0].output.x()));
}

TEST(MipAccelerometerTest, CountsAGapInTheReferenceTimeAsLost) {
  Bench bench;
  bench.accelerometer->start();
  // Up to 2 % of the period off: the time stamps need not lie on a grid.
  for (const std::uint64_t time :
       {1'000'000'000U, 1'010'100'000U, 1'040'000'000U, 1'050'000'000U, 1'750'150'000U}) {
    bench.port->send(data_packet(time, 0, 0, 1));
  }
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(0, 1, 4, 5, 75));
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 5U);
  EXPECT_EQ(health.lost_readings, 2U + 69U);
  EXPECT_EQ(health.bad_frames, 0U);
}

TEST(MipAccelerometerTest, SaysSoWhenTheDeviceWasRestarted) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send(data_packet(5'000'000'000, 0, 0, 1));
  ASSERT_EQ(bench.read_all().size(), 1U);
  bench.port->send(data_packet(20'000'000, 0, 0, 1));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("restarted"));
  EXPECT_THAT(error_of([&] { bench.read_all(); }, Fault::kNotReady), HasSubstr("before it was started"));
  bench.accelerometer->start();
  bench.port->send(data_packet(900'000'000, 0, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(0));
}

std::string gps_packet(double time_of_week_s, unsigned week, unsigned flags) {
  using namespace reference;
  return packet(0x80, field_bytes(0x04, float_bytes(0) + float_bytes(0) + float_bytes(1)) +
                          field_bytes(0x12, bytes_of(std::bit_cast<std::uint64_t>(time_of_week_s), 8) +
                                                bytes_of(week, 2) + bytes_of(flags, 2)));
}

TEST(MipAccelerometerTest, CountsAGapInTheGpsTimestampAsLostButNotAStepOfItsClock) {
  Bench bench(legacy_script());
  bench.accelerometer->start();
  bench.port->send(gps_packet(604'799.99, 2200, 0));
  bench.port->send(gps_packet(0.0, 2201, 0));           // the week is over
  bench.port->send(gps_packet(0.03, 2201, 0));          // two lost
  bench.port->send(gps_packet(0.53, 2201, 0x6));        // a receiver found the time
  bench.port->send(gps_packet(345'600.51, 2300, 0x6));  // or was set otherwise
  bench.port->send(gps_packet(345'600.4, 2300, 0x6));   // set back
  bench.port->send(gps_packet(std::numeric_limits<double>::infinity(), 2300, 0x6));
  bench.port->send(gps_packet(std::nan(""), 2300, 0x6));
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(0, 1, 4, 5, 6, 7, 8, 9));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 2U);
}

FakeMipDevice::Script without_clock() {
  FakeMipDevice::Script script;
  script.descriptors = {0x0102, 0x0103, 0x0104, 0x0106, 0x0C0E, 0x0C0F, 0x8004};
  return script;
}

std::string bare_packet(float x) {
  using namespace reference;
  return packet(0x80, field_bytes(0x04, float_bytes(x) + float_bytes(0) + float_bytes(1)));
}

TEST(MipAccelerometerTest, JudgesLossesByTheDamagedBytesWhereTheDeviceHasNoClock) {
  Bench bench(without_clock());
  bench.accelerometer->start();
  std::string damaged = bare_packet(2);
  damaged[8] = static_cast<char>(damaged[8] ^ 4);
  bench.port->send(bare_packet(1) + damaged + bare_packet(3));
  bench.port->send(bare_packet(4) + "ue" + bare_packet(5));         // two bytes of noise: no reading
  bench.port->send(bare_packet(6).substr(0, 17) + bare_packet(7));  // three bytes left out
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(0, 2, 3, 4, 6));
  bench.port->dropped = 60;  // The input queue ran over: three packets of 20 bytes.
  bench.port->send(bare_packet(8));
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(10));
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 6U);
  EXPECT_EQ(health.lost_readings, 5U);
  EXPECT_EQ(health.skipped_bytes, 20U + 2U + 17U + 60U);
}

TEST(MipAccelerometerTest, CountsPacketsWithImpossibleFieldsAsBad) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send(data_packet(1 * kPeriodNs, 0, 0, 1));
  bench.port->send(reference::packet(0x80, std::string("\x0E\x04", 2)));  // beyond the end
  bench.port->send(reference::packet(0x80, reference::field_bytes(0x04, std::string(8, 0))));  // two floats
  bench.port->send(data_packet(4 * kPeriodNs, 0, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(0, 3));
  EXPECT_EQ(bench.accelerometer->health().bad_frames, 2U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 2U);
}

TEST(MipAccelerometerTest, ReassemblesSplitFramesAndTakesTheArrivalOfTheLastByte) {
  Bench bench;
  bench.accelerometer->start();
  const Clock::Instant began = bench.clock.now();
  const std::string packet = data_packet(kPeriodNs, 0.5F, 0, 1);
  for (std::size_t i = 0; i < packet.size(); ++i) {
    bench.port->send(packet.substr(i, 1), milliseconds(i));
  }
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 0.5);
  EXPECT_EQ(readings[0].arrival, began + milliseconds(packet.size() - 1));
}

TEST(MipAccelerometerTest, TakesReadingsThatCameTogetherWithTheLastAnswer) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x01 || descriptor != 0x06) return false;
    device.send(FakeMipDevice::answer(0x01, 0x06) + data_packet(kPeriodNs, 1, 2, 3) +
                data_packet(2 * kPeriodNs, 4, 5, 6));
    return true;
  };
  Bench bench(script);
  bench.accelerometer->start();
  const Clock::Instant began = bench.clock.now();
  EXPECT_TRUE(bench.accelerometer->next(began + seconds(1)));
  EXPECT_EQ(bench.clock.now(), began) << "nothing to wait for";
  EXPECT_EQ(bench.read_all().size(), 1U);
}

TEST(MipAccelerometerTest, BeginsItsFiguresAtTheStart) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x0C || descriptor != 0x11) return false;
    device.send(FakeMipDevice::answer(set, descriptor) + "noise ue");  // Bytes that belong to no stream yet.
    return true;
  };
  Bench bench(script);
  for (int run = 0; run < 2; ++run) {
    bench.accelerometer->start();
    bench.port->dropped += 10;
    bench.port->send(data_packet(kPeriodNs, 0, 0, 1) + "noise" + data_packet(4 * kPeriodNs, 0, 0, 1));
    const auto readings = bench.read_all();
    EXPECT_THAT(sequences(readings), ::testing::ElementsAre(0, 3));
    EXPECT_FALSE(readings.front().temperature_degc) << "that was of another run";
    const StreamHealth health = bench.accelerometer->health();
    EXPECT_EQ(health.readings, 2U);
    EXPECT_EQ(health.lost_readings, 2U);
    EXPECT_EQ(health.skipped_bytes, 5U + 10U);
    bench.port->send(
        data_packet(5 * kPeriodNs, 0, 0, 1, reference::field_bytes(0x14, std::string(12, '\0'))));
    EXPECT_TRUE(bench.read_all().front().temperature_degc);
  }
}

TEST(MipAccelerometerTest, IgnoresOtherDataSets) {
  Bench bench;
  bench.accelerometer->start();
  std::string other = data_packet(kPeriodNs, 9, 9, 9);
  other[2] = '\x82';
  other = other.substr(0, other.size() - 2);
  bench.port->send(other + reference::bytes_of(reference::checksum(other), 2));
  bench.port->send(data_packet(kPeriodNs, 0, 0, 1));
  const auto readings = bench.read_all();
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.z(), 1.0);
}

TEST(MipAccelerometerTest, DiscardsWhatArrivedBeforeAndCountsNoneOfItAsLost) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send(data_packet(1 * kPeriodNs, 1, 0, 1));
  bench.port->send(data_packet(2 * kPeriodNs, 2, 0, 1));
  ASSERT_TRUE(bench.accelerometer->next(bench.clock.now()));  // The second waits in the driver.
  bench.port->send(data_packet(3 * kPeriodNs, 3, 0, 1));      // The third in the stream.
  const std::string fourth = data_packet(4 * kPeriodNs, 4, 0, 1);
  bench.port->send(fourth.substr(0, 10));  // First half of the fourth, which was made before the discard.
  bench.port->send(fourth.substr(10), milliseconds(1));
  bench.port->send(data_packet(5 * kPeriodNs, 5, 0, 1), milliseconds(10));
  bench.accelerometer->discard_pending();
  const auto readings = bench.read_all(seconds(1));
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].output.x(), 5.0);
  EXPECT_EQ(readings[0].sequence, 4U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
}

TEST(MipAccelerometerTest, BlamesADwellForNothingThatAnOverfullQueueLostBeforeIt) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send(data_packet(1 * kPeriodNs, 1, 0, 1));
  bench.port->dropped = 1000;
  bench.accelerometer->discard_pending();
  bench.port->send(data_packet(50 * kPeriodNs, 1, 0, 1));
  bench.port->send(data_packet(53 * kPeriodNs, 1, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(49, 52));
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 2U);
  EXPECT_EQ(bench.accelerometer->health().skipped_bytes, 1000U);
}

TEST(MipAccelerometerTest, BlamesADwellForNothingThatWasLostAmongWhatItThrowsAway) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send(data_packet(1 * kPeriodNs, 1, 0, 1) + data_packet(90 * kPeriodNs, 1, 0, 1));
  bench.port->dropped = 1000;
  bench.accelerometer->discard_pending();
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 0U);
  // Where no queue ran over, the device or the line lost it: that counts.
  bench.port->send(data_packet(91 * kPeriodNs, 1, 0, 1) + data_packet(93 * kPeriodNs, 1, 0, 1));
  bench.accelerometer->discard_pending();
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 1U);
}

TEST(MipAccelerometerTest, CountsWhatAFullQueueLost) {
  Bench bench;
  bench.accelerometer->start();
  std::string bytes;
  for (std::uint64_t i = 1; i <= 10'000; ++i) bytes += data_packet(i * kPeriodNs, 0, 0, 1);
  bench.port->send(bytes);
  std::size_t given = bench.read_all().size();
  EXPECT_EQ(given, 8192U);
  bench.port->send(data_packet(10'001 * kPeriodNs, 0, 0, 1));
  EXPECT_THAT(sequences(bench.read_all()), ::testing::ElementsAre(10'000));
  EXPECT_EQ(bench.accelerometer->health().readings, 8193U);
  EXPECT_EQ(bench.accelerometer->health().lost_readings, 10'000U - 8192U);
}

TEST(MipAccelerometerTest, NeedsAStart) {
  Bench bench;
  EXPECT_THAT(error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kNotReady),
              HasSubstr("started"));
  bench.accelerometer->start();
  EXPECT_NO_THROW(bench.read_all());
  bench.accelerometer->identify();
  error_of([&] { bench.read_all(); }, Fault::kNotReady);
  bench.accelerometer->start();
  bench.accelerometer->stop();
  EXPECT_EQ(hex(bench.port->commands.back()), "756501020202E1C7");
  error_of([&] { bench.read_all(); }, Fault::kNotReady);
}

TEST(MipAccelerometerTest, KeepsItsFiguresAfterTheStop) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->send("noise" + data_packet(1 * kPeriodNs, 0, 0, 1) + data_packet(4 * kPeriodNs, 0, 0, 1));
  EXPECT_EQ(bench.read_all().size(), 2U);
  bench.accelerometer->stop();
  const StreamHealth health = bench.accelerometer->health();
  EXPECT_EQ(health.readings, 2U);
  EXPECT_EQ(health.lost_readings, 2U);
  EXPECT_EQ(health.skipped_bytes, 5U);
}

// Failures of the communication.

TEST(MipAccelerometerTest, TakesNoAnswerThatWasThereBeforeTheQuestion) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice&, unsigned, unsigned) { return true; };
  Bench bench(script);
  bench.port->send(FakeMipDevice::answer(0x01, 0x02));
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply), HasSubstr("set idle"));
}

TEST(MipAccelerometerTest, TakesNoAnswerOfAnotherDescriptorSet) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x01 || descriptor != 0x06) return false;
    device.send(FakeMipDevice::answer(0x0C, 0x06, 1));  // Like the one to "resume", but to another command.
    return false;
  };
  Bench bench(script);
  EXPECT_NO_THROW(bench.accelerometer->start());
}

TEST(MipAccelerometerTest, SaysThatASilentPortIsSilentAfterTwoTries) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice&, unsigned, unsigned) { return true; };
  Bench bench(script);
  const Clock::Instant began = bench.clock.now();
  EXPECT_THAT(
      error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply),
      AllOf(HasSubstr("set idle"), HasSubstr("not one byte"), HasSubstr("baud rate"), HasSubstr("scripted")));
  EXPECT_NEAR(to_seconds(bench.clock.now() - began), kTwoTries, 1e-6);  // Deadlines are rounded to 1 ns.
  EXPECT_EQ(bench.port->count_sent(0x01, 0x02), 2);
  bench.accelerometer->stop();  // Must not throw.
}

TEST(MipAccelerometerTest, TellsAnotherInstrumentByItsBytes) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned, unsigned) {
    device.send("$VNRRG,01,VN-100*0A\r\n", milliseconds(5));
    return true;
  };
  Bench bench(script);
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("24 56 4E 52"), HasSubstr("no MIP packet"), HasSubstr("another instrument")));
}

TEST(MipAccelerometerTest, TellsALineOnWhichEveryPacketIsDamaged) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    std::string answer = FakeMipDevice::answer(set, descriptor);
    answer.back() = static_cast<char>(answer.back() ^ 1);
    device.send(answer, milliseconds(1));
    return true;
  };
  Bench bench(script);
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kBadFrame),
              HasSubstr("wrong checksum"));
}

TEST(MipAccelerometerTest, RefusesAMipDeviceWithoutAccelerometer) {
  FakeMipDevice::Script script;
  script.descriptors = {0x0102, 0x0103, 0x0104, 0x0106, 0x0C0E, 0x0C0F, 0x8103};
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kWrongIdentity),
              AllOf(HasSubstr("3DM-GX5-25"), HasSubstr("80,04")));
  script.descriptors = {0x0102, 0x0103, 0x0104, 0x0106, 0x0C06, 0x0C0F, 0x8004};
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kWrongIdentity),
              HasSubstr("0C,08"));
}

TEST(MipAccelerometerTest, PutsARefusalInWords) {
  for (const auto& [code, words] : std::vector<std::pair<unsigned, std::string>>{{1, "unknown command"},
                                                                                 {2, "checksum"},
                                                                                 {3, "parameter"},
                                                                                 {4, "failed"},
                                                                                 {5, "timed out"},
                                                                                 {77, "no meaning"}}) {
    FakeMipDevice::Script script;
    script.on_command = [refusal = code](FakeMipDevice& device, unsigned set, unsigned descriptor) {
      if (set != 0x0C || descriptor != 0x0F) return false;
      device.send(FakeMipDevice::answer(set, descriptor, refusal), milliseconds(1));
      return true;
    };
    Bench bench(script);
    EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused),
                AllOf(HasSubstr("code " + std::to_string(code)), HasSubstr(words),
                      HasSubstr("message format"), HasSubstr("SN 6253.12345")));
    EXPECT_EQ(bench.port->count_sent(0x0C, 0x0F), 1) << "a refusal is an answer";
    EXPECT_FALSE(bench.port->was_sent(0x01, 0x06));
  }
}

TEST(MipAccelerometerTest, GoesOnIfAnotherStreamCannotBeSwitchedOff) {
  FakeMipDevice::Script script;
  script.descriptors.push_back(0x8201);
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x0C || descriptor != 0x11 || device.count_sent(set, descriptor) > 1) return false;
    device.send(FakeMipDevice::answer(set, descriptor, 3), milliseconds(1));
    return true;
  };
  Bench bench(script);
  bench.accelerometer->start();
  EXPECT_EQ(bench.port->count_sent(0x0C, 0x11), 2);
  EXPECT_TRUE(bench.port->was_sent(0x01, 0x06));
}

TEST(MipAccelerometerTest, RefusesAnswersWithoutTheirContent) {
  for (const unsigned bare : {0x0103U, 0x0104U, 0x0C0EU}) {
    FakeMipDevice::Script script;
    script.on_command = [bare](FakeMipDevice& device, unsigned set, unsigned descriptor) {
      if (set * 256 + descriptor != bare) return false;
      device.send(FakeMipDevice::answer(set, descriptor), milliseconds(1));
      return true;
    };
    EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kBadFrame),
                HasSubstr("without"));
  }
  FakeMipDevice::Script script;
  script.base_rate_hz = 0;
  EXPECT_THAT(error_of([&] { Bench(script).accelerometer->identify(); }, Fault::kBadFrame),
              HasSubstr("no rate"));
}

/// A device that streams at 100 Hz from the start, in the midst of a packet, until it is told to stop.
void stream_for(FakeMipDevice& device, WaitingClock& clock, Clock::Duration duration) {
  device.send(data_packet(1, 0, 0, 1).substr(9));
  for (std::uint64_t i = 1; milliseconds(10 * i) < duration; ++i) {
    device.send_at(clock.now() + milliseconds(10 * i), data_packet(i * kPeriodNs, 0, 0, 1));
  }
}

TEST(MipAccelerometerTest, FindsItsAnswersInTheMidstOfAStream) {
  Bench bench;
  // All the while: "set idle" is acknowledged, and the device sends on, as one whose buffer is long.
  stream_for(*bench.port, bench.clock, seconds(2));
  EXPECT_EQ(bench.accelerometer->identify().model, "3DM-GX5-25");
  EXPECT_EQ(bench.port->count_sent(0x01, 0x02), 1);
}

TEST(MipAccelerometerTest, RepeatsSetIdleWhileDataStreams) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    return set == 0x01 && descriptor == 0x02 &&
           device.count_sent(set, descriptor) < 4;  // Drowned three times.
  };
  Bench bench(script);
  stream_for(*bench.port, bench.clock, seconds(60));
  EXPECT_EQ(bench.accelerometer->identify().model, "3DM-GX5-25");
  EXPECT_EQ(bench.port->count_sent(0x01, 0x02), 4);
}

TEST(MipAccelerometerTest, SaysThatDataStreamsThoughNothingIsAnswered) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice&, unsigned, unsigned) { return true; };
  Bench bench(script);
  stream_for(*bench.port, bench.clock, seconds(60));
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply),
              HasSubstr("other MIP packets"));
}

TEST(MipAccelerometerTest, RepeatsACommandWhoseAnswerWasDamaged) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x01 || descriptor != 0x04 || device.count_sent(set, descriptor) > 1) return false;
    device.send("ue\x01\xFF", milliseconds(1));  // A false sync that claims the second answer too.
    return true;
  };
  Bench bench(script);
  EXPECT_EQ(bench.accelerometer->identify().model, "3DM-GX5-25");
  EXPECT_EQ(bench.port->count_sent(0x01, 0x04), 2);
  EXPECT_EQ(bench.port->count_sent(0x01, 0x01), 1) << "a ping makes sure that no answer is to come";
}

TEST(MipAccelerometerTest, NeverTakesALateAnswerForThatOfTheNextCommand) {
  // The filter stream is switched off, and the answer comes only after the second try; then, late, the second
  // answer, which would pass for the one to "stream on". "stream on" itself is refused.
  FakeMipDevice::Script script;
  script.descriptors.push_back(0x8201);
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set == 0x01 && descriptor == 0x01) {  // Follows the late answer, because the device answers in order.
      device.send(FakeMipDevice::answer(set, descriptor), milliseconds(700));
      return true;
    }
    if (set != 0x0C || descriptor != 0x11) return false;
    switch (device.count_sent(set, descriptor)) {
      case 1:
        device.send(FakeMipDevice::answer(set, descriptor), milliseconds(2'500));
        break;
      case 2:
        device.send(FakeMipDevice::answer(set, descriptor), milliseconds(1'000));
        break;
      default:
        device.send(FakeMipDevice::answer(set, descriptor, 4), milliseconds(800));
    }
    return true;
  };
  Bench bench(script);
  EXPECT_THAT(error_of([&] { bench.accelerometer->start(); }, Fault::kRefused), HasSubstr("stream on"));
}

TEST(MipAccelerometerTest, CountsNoRefusalWhileAnEarlierTryIsOutstanding) {
  // "message format" is refused, too late: the refusal arrives before the answer to the second try.
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice& device, unsigned set, unsigned descriptor) {
    if (set != 0x0C || descriptor != 0x0F || device.count_sent(set, descriptor) > 1) return false;
    device.send(FakeMipDevice::answer(set, descriptor, 3),
                from_seconds(kTwoTries / 2.0) + std::chrono::microseconds(500));
    return true;
  };
  Bench bench(script);
  EXPECT_NO_THROW(bench.accelerometer->start());
  EXPECT_EQ(bench.port->count_sent(0x0C, 0x0F), 2);
}

TEST(MipAccelerometerTest, NeverTakesALateAnswerAfterAFailure) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice&, unsigned set, unsigned descriptor) {
    return set == 0x01 && descriptor == 0x03;  // Not answered in time, both times.
  };
  Bench bench(script);
  EXPECT_THAT(error_of([&] { bench.accelerometer->identify(); }, Fault::kNoReply), HasSubstr("device info"));
  // Both answers come while the next attempt is under way, before its own (a device answers in order).
  std::string stale = FakeMipDevice::info_reply("stale           ");
  stale.replace(2, 16, "OLD MODEL       ");
  for (int i = 0; i < 2; ++i) {
    bench.port->send(FakeMipDevice::answer(0x01, 0x03, 0, 0x81, stale), std::chrono::microseconds(500));
  }
  bench.port->script.on_command = nullptr;
  EXPECT_EQ(bench.accelerometer->identify().model, "3DM-GX5-25");
}

TEST(MipAccelerometerTest, ReportsAnUnpluggedDevice) {
  Bench bench;
  bench.accelerometer->start();
  bench.port->unplugged = true;
  error_of([&] { bench.accelerometer->next(bench.clock.now()); }, Fault::kLinkLost);
  error_of([&] { bench.accelerometer->discard_pending(); }, Fault::kLinkLost);
  bench.accelerometer->stop();  // Must not throw.
  error_of([&] { bench.accelerometer->identify(); }, Fault::kLinkLost);
  bench.port->unplugged = false;
  bench.accelerometer->start();
  bench.port->send(data_packet(kPeriodNs, 0, 0, 1));
  EXPECT_EQ(bench.read_all().size(), 1U);
}

// The recorded stream of a real device: it begins with the answer to "resume", then 80,D5 and 80,04 at 8 ms.

std::string read_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Starts the driver with these bytes as the answer to "resume", in pieces, and reads all.
struct Replayed {
  std::vector<Reading> readings;
  StreamHealth health;
};

Replayed replay(const std::string& bytes, std::mt19937& random, std::size_t longest_piece) {
  FakeMipDevice::Script script;
  script.on_command = [](FakeMipDevice&, unsigned set, unsigned descriptor) {
    return set == 0x01 && descriptor == 0x06;  // Answered from the recording.
  };
  AccelerometerSettings settings;
  settings.rate_hz = 125.0;
  Bench bench(script, settings);
  const Clock::Instant begin = bench.clock.now() + seconds(1);
  int n = 0;
  for (std::size_t at = 0; at < bytes.size(); ++n) {
    const std::size_t size = 1 + random() % longest_piece;
    bench.port->send_at(begin + std::chrono::microseconds(n), bytes.substr(at, size));
    at += size;
  }
  bench.accelerometer->start();
  Replayed replayed;
  replayed.readings = bench.read_all(seconds(10));
  replayed.health = bench.accelerometer->health();
  return replayed;
}

TEST(MipAccelerometerTest, GivesEveryReadingOfARecordedStreamInOrder) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "wire/mip_stream.bin");
  const std::string bytes = read_file(path);
  for (const std::size_t longest_piece : {std::size_t{1}, std::size_t{500}, bytes.size()}) {
    std::mt19937 random(1);
    const Replayed replayed = replay(bytes, random, longest_piece);
    ASSERT_EQ(replayed.readings.size(), 4473U);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < replayed.readings.size(); ++i) {
      EXPECT_EQ(replayed.readings[i].sequence, i);
      sum += replayed.readings[i].output;
    }
    EXPECT_NEAR(sum.x() / 4473.0, -0.05059853, 5e-9);  // Half of the last digit printed with the data.
    EXPECT_EQ(replayed.health.readings, 4473U);
    EXPECT_EQ(replayed.health.lost_readings, 0U);
    EXPECT_EQ(replayed.health.bad_frames, 0U);
    EXPECT_EQ(replayed.health.skipped_bytes, 0U);
  }
}

TEST(MipAccelerometerTest, GivesOfADamagedStreamOnlyTrueReadingsAndCountsTheOthers) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "wire/mip_stream.bin");
  const std::string recorded = read_file(path).substr(0, 60'000);
  // The truth: the readings of the undamaged recording by their reference time.
  std::map<std::uint64_t, std::string> truth;
  for (const auto& packet : reference::decode(recorded).packets) {
    if (packet.set != 0x80) continue;
    const auto acceleration = reference::field(packet, 0x04);
    const auto time = reference::field(packet, 0xD5);
    if (acceleration && time) truth[reference::number(*time)] = *acceleration;
  }
  ASSERT_GT(truth.size(), 700U);

  std::size_t lost_in_all = 0;
  for (unsigned seed = 0; seed < 100; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    std::string bytes = recorded;
    for (std::size_t faults = random() % 60; faults > 0; --faults) {
      const std::size_t at = 10 + random() % (bytes.size() - 100);  // Behind the answer to "resume".
      switch (random() % 3) {
        case 0:
          bytes.insert(at,
                       random() % 2 ? std::string("ue\x80\xFF\x0E\x04", 6) : std::string(random() % 50, 'u'));
          break;
        case 1:
          bytes.erase(at, 1 + random() % 90);
          break;
        default:
          bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
      }
    }
    // Packets that a slow decoder finds in the damaged bytes, in order.
    std::vector<std::pair<std::uint64_t, std::string>> expected;
    const reference::Decoded decoded = reference::decode(bytes);
    for (const auto& packet : decoded.packets) {
      if (packet.set != 0x80) continue;
      const auto acceleration = reference::field(packet, 0x04);
      const auto time = reference::field(packet, 0xD5);
      if (acceleration && time) expected.emplace_back(reference::number(*time), *acceleration);
    }
    const Replayed replayed = replay(bytes, random, 700);
    // The last packets may wait behind a false sync; the driver may find them, the reference does not.
    ASSERT_GE(replayed.readings.size(), expected.size());
    ASSERT_LE(replayed.readings.size(), expected.size() + 3);
    for (std::size_t i = 0; i < expected.size(); ++i) {
      const auto& [time, acceleration] = expected[i];
      ASSERT_EQ(truth.count(time), 1U);
      EXPECT_EQ(truth[time], acceleration);
      for (int axis = 0; axis < 3; ++axis) {
        EXPECT_EQ(replayed.readings[i].output(axis),
                  static_cast<double>(reference::float_at(acceleration, 4 * static_cast<std::size_t>(axis))));
      }
      EXPECT_EQ(replayed.readings[i].sequence, (time - expected.front().first + 4'000'000) / 8'000'000);
    }
    const std::uint64_t made = replayed.readings.back().sequence + 1;
    EXPECT_EQ(replayed.health.lost_readings, made - replayed.readings.size());
    EXPECT_EQ(replayed.health.readings, replayed.readings.size());
    lost_in_all += replayed.health.lost_readings;
  }
  EXPECT_GT(lost_in_all, 1000U) << "the damage must have cost something";
}

TEST(MipAccelerometerTest, TellsTheBiasThatTheDeviceSubtracts) {
  sim::SimClock clock;
  auto world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  const auto device = std::make_shared<sim::MipFirmware>(world);
  // 0C,37: write (0.25, 0, -0.5) g.
  const std::string bias("\x75\x65\x0C\x0F\x0F\x37\x01\x3E\x80\0\0\0\0\0\0\xBF\0\0\0", 19);
  unsigned a = 0;
  unsigned b = 0;
  for (const char c : bias) b = (b + (a = (a + static_cast<unsigned char>(c)) % 256)) % 256;
  device->receive(bias + static_cast<char>(a) + static_cast<char>(b), clock.now());
  MipAccelerometer accelerometer(std::make_unique<sim::FirmwareStream>(device, clock), clock,
                                 AccelerometerSettings());
  accelerometer.identify();
  const auto registers = accelerometer.correction_registers();
  ASSERT_EQ(registers.size(), 1U);
  EXPECT_EQ(registers.at("accelerometer bias (0C,37)"), "0.25, 0, -0.5 g");
  accelerometer.start();
  const auto reading = accelerometer.next(clock.now() + std::chrono::seconds(1));
  ASSERT_TRUE(reading);
  EXPECT_EQ(reading->output, Eigen::Vector3d(-0.25, 0.0, 1.5));
}

}  // namespace
}  // namespace abcal
