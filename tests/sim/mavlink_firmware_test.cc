// Frames of a host as node-mavlink writes them, and what comes back.

#include "sim/firmware/mavlink_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;

/// CRC-16/MCRF4XX, by its table-free form of a nibble at a time.
unsigned mavlink_crc(const std::string& bytes) {
  unsigned crc = 0xFFFFU;
  for (const char c : bytes) {
    unsigned t = static_cast<unsigned char>(c) ^ (crc & 0xFFU);
    t = (t ^ t << 4U) & 0xFFU;
    crc = (crc >> 8U ^ t << 8U ^ t << 3U ^ t >> 4U) & 0xFFFFU;
  }
  return crc;
}

struct MavlinkMessage {
  unsigned id;
  std::string payload;
};

class MavlinkFirmwareTest : public testing::Test {
 protected:
  static std::string frame(unsigned id, unsigned extra, const std::string& payload) {
    std::string body{static_cast<char>(payload.size()),
                     '\0',
                     '\0',
                     '\x05',
                     '\xFF',
                     '\xBE',
                     static_cast<char>(id),
                     '\0',
                     '\0'};
    body += payload;
    const unsigned crc = mavlink_crc(body + static_cast<char>(extra));
    return '\xFD' + body + static_cast<char>(crc % 256U) + static_cast<char>(crc / 256U);
  }
  std::vector<MavlinkMessage> ask(const std::string& bytes) {
    host.send(bytes);
    const std::string answer = host.listen(milliseconds(100));
    std::vector<MavlinkMessage> messages;
    for (std::size_t at = 0; at + 12 <= answer.size();) {
      const auto size = static_cast<std::size_t>(static_cast<unsigned char>(answer[at + 1]));
      const unsigned id =
          static_cast<unsigned char>(answer[at + 7]) + 256U * static_cast<unsigned char>(answer[at + 8]);
      std::string payload = answer.substr(at + 10, size);
      payload.resize(64, '\0');
      if (id != 0) messages.push_back({id, payload});
      at += size + 12;
    }
    return messages;
  }
  /// @param floats  the first of the seven parameters
  static std::string command_long(unsigned command, std::string floats) {
    floats.resize(28, '\0');
    std::string payload = std::move(floats);
    payload += {static_cast<char>(command % 256U), static_cast<char>(command / 256U), '\x01', '\x01', '\0'};
    return frame(76, 152, payload);
  }
  static std::string parameter_name(const MavlinkMessage& value) {
    const std::string name = value.payload.substr(8, 16);
    return name.substr(0, name.find('\0'));
  }

  static BenchTruth in_mps2() {
    BenchTruth truth;
    truth.sensitivity_matrix *= 9.81;
    return truth;
  }
  std::shared_ptr<SimBench> bench = std::make_shared<SimBench>(in_mps2());
  MavlinkFirmware firmware{bench};
  FirmwareHost host{firmware};
};

TEST_F(MavlinkFirmwareTest, ListsItsParametersEachWithItsIndex) {
  const auto values = ask(frame(21, 159, "\x01\x01"));
  ASSERT_EQ(values.size(), 9U);
  for (std::size_t n = 0; n < values.size(); ++n) {
    EXPECT_EQ(values[n].id, 22U);
    EXPECT_EQ(static_cast<unsigned char>(values[n].payload[4]), 9U) << "how many there are";
    EXPECT_EQ(static_cast<unsigned char>(values[n].payload[6]), n);
  }
  EXPECT_EQ(parameter_name(values[0]), "CAL_ACC0_XOFF");
  // By its index, which comes first in the payload, and by its name.
  const auto third = ask(frame(20, 214, std::string("\x02\0\x01\x01", 4) + std::string(16, '\0')));
  ASSERT_EQ(third.size(), 1U);
  EXPECT_EQ(parameter_name(third[0]), parameter_name(values[2]));
  std::string name = "SENS_BOARD_ROT";
  name.resize(16, '\0');
  EXPECT_EQ(parameter_name(ask(frame(20, 214, "\xFF\xFF\x01\x01" + name)).at(0)), "SENS_BOARD_ROT");
  EXPECT_TRUE(firmware.unserved().all().empty());
  EXPECT_TRUE(ask(frame(20, 214, std::string("\x63\0\x01\x01", 4) + std::string(16, '\0'))).empty());
  EXPECT_EQ(firmware.unserved().all().at(0).command, "parameter 99");
}

TEST_F(MavlinkFirmwareTest, TellsTheIntervalOfAMessage) {
  using namespace std::string_literals;
  ask(command_long(511, "\0\0\xD2\x42\0\x40\x9C\x46"s));  // HIGHRES_IMU each 20000 us
  const std::map<std::string, std::pair<unsigned, std::int32_t>> expected{
      {"\0\0\xD2\x42"s, {105, 20000}},  // HIGHRES_IMU
      {"\0\0\xD0\x41"s, {26, -1}},      // SCALED_IMU, which is not sent
      {"\0\0\0\0"s, {0, 1000000}},      // HEARTBEAT
      {"\0\0\x80\x3F"s, {1, 0}},        // SYS_STATUS, which it does not have
  };
  for (const auto& [number, interval] : expected) {
    MavlinkMessage acknowledgement{};
    MavlinkMessage told{};
    for (const MavlinkMessage& each : ask(command_long(510, number))) {
      if (each.id == 77) acknowledgement = each;
      if (each.id == 244) told = each;
    }
    EXPECT_EQ(acknowledgement.payload.substr(0, 3), "\xFE\x01\0"s) << interval.first;
    ASSERT_EQ(told.id, 244U) << interval.first;
    std::int32_t value = 0;
    for (std::size_t n = 4; n > 0; --n)
      value = static_cast<std::int32_t>(static_cast<std::uint32_t>(value) << 8U |
                                        static_cast<unsigned char>(told.payload[n - 1]));
    EXPECT_EQ(value, interval.second) << interval.first;
    EXPECT_EQ(static_cast<unsigned char>(told.payload[4]), interval.first);
  }
}

}  // namespace
}  // namespace abcal::sim
