#include "sim/firmware/vectornav_firmware.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cstdint>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

/// XOR and CRC as the maker's manual words them, not the firmware's.
std::string xor_sum(const std::string& text) {
  int sum = 0;
  for (const char c : text) sum ^= static_cast<unsigned char>(c);
  return fmt::format("{:02X}", sum);
}
unsigned crc(const std::string& bytes) {
  // Bit by bit: polynomial 1021, initial value 0.
  unsigned value = 0;
  for (const char c : bytes) {
    value ^= static_cast<unsigned>(static_cast<unsigned char>(c)) << 8U;
    for (int bit = 0; bit < 8; ++bit) value = (value & 0x8000U) != 0 ? (value << 1U) ^ 0x1021U : value << 1U;
    value &= 0xFFFFU;
  }
  return value;
}

std::vector<std::string> lines_of(const std::string& bytes) {
  std::vector<std::string> lines;
  std::istringstream in(bytes);
  for (std::string line; std::getline(in, line);) {
    EXPECT_EQ(line.back(), '\r');
    line.pop_back();
    lines.push_back(line);
  }
  return lines;
}

std::vector<double> numbers_of(const std::string& line) {
  std::vector<double> numbers;
  std::istringstream in(line.substr(0, line.find('*')));
  std::string word;
  std::getline(in, word, ',');
  while (std::getline(in, word, ',')) numbers.push_back(std::stod(word));
  return numbers;
}

class VectorNavFirmwareTest : public testing::Test {
 protected:
  explicit VectorNavFirmwareTest(VectorNavSettings settings = quiet(), BenchTruth truth = ideal())
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  static VectorNavSettings quiet() {
    VectorNavSettings settings;
    settings.async_type = 0;
    return settings;
  }
  static BenchTruth ideal() {
    BenchTruth truth;
    truth.sensitivity_matrix *= 9.81;  // R is m/s2
    return truth;
  }

  std::string raw(const std::string& bytes) { return host.exchange(bytes); }
  /// Sends a command with the 8-bit checksum, which the reply must have as well.
  std::string ask(const std::string& text) {
    const std::string answer = host.exchange("$" + text + "*" + xor_sum(text) + "\r\n");
    if (answer.size() < 6) return answer;
    const std::string body = answer.substr(1, answer.size() - 6);
    EXPECT_EQ(answer, "$" + body + "*" + xor_sum(body) + "\r\n");
    return body;
  }

  std::shared_ptr<SimBench> bench;
  VectorNavFirmware firmware;
  FirmwareHost host;
};

TEST_F(VectorNavFirmwareTest, TheFramesOfTheMakersSdkAreAnsweredWithTheCrc) {
  for (const auto& [sent, answered] :
       {std::pair<std::string, std::string>{"$VNRRG,01*E15F\r\n", "VNRRG,01,VN-100T-CR"},
        {"$VNWRG,06,1,1*CA15\r\n", "VNWRG,06,1,1"},
        {"$VNWRG,07,2,1*3914\r\n", "VNWRG,07,2,1"},
        {"$VNWRG,75,3,400,01,0321*D84E\r\n", "VNWRG,75,3,400,01,0321"}}) {
    const std::string answer = raw(sent);
    EXPECT_THAT(answer, StartsWith(fmt::format("${}*{:04X}\r\n", answered, crc(answered)))) << sent;
  }
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,1");
  EXPECT_EQ(ask("VNRRG,07"), "VNRRG,07,2");
}

TEST_F(VectorNavFirmwareTest, TheXorFormsAreAnsweredWithTheXor) {
  EXPECT_EQ(raw("$VNRRG,01*72\r\n"), "$VNRRG,01,VN-100T-CR*" + xor_sum("VNRRG,01,VN-100T-CR") + "\r\n");
  EXPECT_THAT(raw("$VNRRG,54*72\r\n"), StartsWith("$VNRRG,54,"));
  EXPECT_EQ(raw("$VNWRG,06,0*6C\r\n"), "$VNWRG,06,0*6C\r\n");
  EXPECT_EQ(raw("$VNWRG,07,40*59\r\n"), "$VNWRG,07,40*59\r\n");
  EXPECT_EQ(raw("$VNASY,0*4F\r\n"), "$VNASY,0*4F\r\n");
}

TEST_F(VectorNavFirmwareTest, TheStylesOfDifferentHostsAreTaken) {
  EXPECT_THAT(raw("$VNRRG,3*XX\n"), StartsWith("$VNRRG,03,0100012345*"));
  EXPECT_THAT(raw("$VNRRG,03*XX\r"), StartsWith("$VNRRG,03,"));
  EXPECT_THAT(raw("\x75\x65garbage$VNR$VNRRG,03*XX\r\n"), StartsWith("$VNRRG,03,"));
  host.send("$VNRR");
  host.send("G,0");
  EXPECT_THAT(raw("3*XX\r\n"), StartsWith("$VNRRG,03,"));
  EXPECT_THAT(lines_of(raw("$VNRRG,03*XX\r\n$VNRRG,04*XX\r\n")), testing::SizeIs(2));
  EXPECT_EQ(raw("VNRRG,03*XX\r\n"), "") << "no beginning";
}

TEST_F(VectorNavFirmwareTest, MistakesAreAnsweredWithTheMakersCodes) {
  EXPECT_EQ(raw("$VNRRG,01*73\r\n"), "$VNERR,03*" + xor_sum("VNERR,03") + "\r\n");
  EXPECT_THAT(raw("$VNRRG,01*E15E\r\n"), StartsWith("$VNERR,03*"));
  EXPECT_THAT(raw("$VNRRG,01\r\n"), StartsWith("$VNERR,03*"));
  EXPECT_EQ(ask("VNXYZ"), "VNERR,04");
  EXPECT_EQ(ask("VNRRG"), "VNERR,05");
  EXPECT_EQ(ask("VNWRG,06"), "VNERR,05");
  EXPECT_EQ(ask("VNRRG,01,2"), "VNERR,06");
  EXPECT_EQ(ask("VNWRG,06,1,1,1"), "VNERR,06");
  EXPECT_EQ(ask("VNWRG,06,7"), "VNERR,07");
  EXPECT_EQ(ask("VNWRG,07,30"), "VNERR,07");
  EXPECT_EQ(ask("VNWRG,05,100000"), "VNERR,07");
  EXPECT_EQ(ask("VNWRG,75,1,0,01,0001"), "VNERR,07");
  EXPECT_EQ(ask("VNWRG,75,1,8,08,4000"), "VNERR,07") << "the GNSS group has 14 fields";
  EXPECT_EQ(ask("VNWRG,75,1,8,05,0001"), "VNERR,05");
  EXPECT_EQ(ask("VNRRG,99"), "VNERR,08");
  EXPECT_EQ(ask("VNWRG,99,1"), "VNERR,08");
  EXPECT_EQ(ask("VNWRG,01,VN-200"), "VNERR,09");
  EXPECT_EQ(raw("$" + std::string(300, 'V')), "$VNERR,02*" + xor_sum("VNERR,02") + "\r\n");
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0") << "nothing of all that was taken";
}

TEST_F(VectorNavFirmwareTest, RegistersAreReadAndWritten) {
  EXPECT_EQ(ask("VNRRG,02"), "VNRRG,02,7");
  EXPECT_EQ(ask("VNRRG,04"), "VNRRG,04,2.1.0.0");
  EXPECT_EQ(ask("VNRRG,05"), "VNRRG,05,115200");
  EXPECT_EQ(ask("VNWRG,00,bench 2"), "VNWRG,00,bench 2");
  EXPECT_EQ(ask("VNRRG,00"), "VNRRG,00,bench 2");
  EXPECT_EQ(ask("VNWRG,06,19,2"), "VNWRG,06,19,2");
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0") << "the other port's";
  EXPECT_EQ(ask("VNRRG,06,2"), "VNRRG,06,19");
  EXPECT_EQ(ask("VNRRG,06,3"), "VNERR,07");
  const auto imu = numbers_of(ask("VNRRG,54"));
  ASSERT_EQ(imu.size(), 12U);  // the register's number first
  EXPECT_EQ(imu[4], 0.0);
  EXPECT_EQ(imu[6], 9.81);
  EXPECT_EQ(imu[10], 23.0);
  EXPECT_EQ(imu[11], 101.325);
}

TEST_F(VectorNavFirmwareTest, SettingsAreSavedAndRestored) {
  ask("VNWRG,06,11");
  EXPECT_EQ(ask("VNRST"), "VNRST");
  EXPECT_EQ(raw("$VNRRG,06*XX\r\n"), "") << "it is starting";
  host.listen(seconds(1));
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0") << "it was not saved";
  ask("VNWRG,06,11");
  ask("VNWNV");
  ask("VNRST");
  host.listen(seconds(1));
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,11");
  ask("VNRFS");
  host.listen(seconds(1));
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0");
}

TEST_F(VectorNavFirmwareTest, AsciiMessagesComeAtTheirRateWithTheWorldsOutput) {
  ask("VNWRG,07,50");
  ask("VNWRG,06,11");
  const auto lines = lines_of(host.listen(seconds(2)));
  ASSERT_EQ(lines.size(), 100U);
  for (const std::string& line : lines) {
    EXPECT_THAT(line, StartsWith("$VNACC,"));
    EXPECT_EQ(line.substr(line.size() - 2), xor_sum(line.substr(1, line.size() - 4)));
  }
  EXPECT_EQ(lines[0].substr(0, lines[0].find('*')), "$VNACC,+00.000,+00.000,+09.810");
  bench->move(StageAxis::kX, Angle::degrees(90.0), host.clock().now());
  host.listen(seconds(10));
  EXPECT_NEAR(numbers_of(lines_of(host.listen(milliseconds(30)))[0])[1], 9.81, 5e-4);  // half a printed digit
}

TEST_F(VectorNavFirmwareTest, EveryTypeHasItsShape) {
  const std::vector<std::tuple<int, std::string, std::size_t>> types{
      {1, "VNYPR", 3},  {2, "VNQTN", 4},  {10, "VNMAG", 3},  {11, "VNACC", 3},
      {12, "VNGYR", 3}, {13, "VNMAR", 9}, {14, "VNYMR", 12}, {19, "VNIMU", 11}};
  ask("VNWRG,07,10");
  for (const auto& [type, name, values] : types) {
    ask(fmt::format("VNWRG,06,{}", type));
    const auto lines = lines_of(host.listen(milliseconds(100)));
    ASSERT_EQ(lines.size(), 1U) << name;
    EXPECT_THAT(lines[0], StartsWith("$" + name + ","));
    EXPECT_EQ(numbers_of(lines[0]).size(), values) << name;
  }
  ask("VNWRG,06,0");
  EXPECT_THAT(host.listen(seconds(1)), IsEmpty());
}

TEST_F(VectorNavFirmwareTest, CountAndStatusAreAppendedAndTheCrcIsUsedIfAskedFor) {
  ask("VNWRG,06,11");
  EXPECT_EQ(ask("VNWRG,30,1,1,0,0,3,0,1").substr(0, 8), "VNWRG,30");
  const auto lines = lines_of(host.listen(milliseconds(60)));
  ASSERT_GE(lines.size(), 2U);
  const std::string& line = lines[0];
  EXPECT_THAT(line, HasSubstr(",T"));
  EXPECT_THAT(line, HasSubstr(",S"));
  EXPECT_EQ(line.substr(line.size() - 4), fmt::format("{:04X}", crc(line.substr(1, line.size() - 6))));
}

TEST_F(VectorNavFirmwareTest, BinaryPacketsHoldTheWorldsOutput) {
  // Time since startup, acceleration, and from the IMU group the temperature.
  EXPECT_EQ(ask("VNWRG,75,1,8,05,0101,0010"), "VNWRG,75,1,8,05,0101,0010");
  EXPECT_EQ(ask("VNRRG,75"), "VNRRG,75,1,8,05,0101,0010");
  const std::string bytes = host.listen(seconds(1));
  constexpr std::size_t kPacket = 1 + 1 + 4 + 8 + 12 + 4 + 2;
  ASSERT_EQ(bytes.size(), 100 * kPacket);
  std::uint64_t before = 0;
  for (std::size_t at = 0; at < bytes.size(); at += kPacket) {
    const std::string packet = bytes.substr(at, kPacket);
    EXPECT_EQ(packet.substr(0, 6), std::string("\xFA\x05\x01\x01\x10\x00", 6));
    EXPECT_EQ(crc(packet.substr(1)), 0U);
    const auto little_endian = [&](std::size_t from, std::size_t count) {
      std::uint64_t value = 0;
      for (std::size_t n = count; n-- > 0;)
        value = value << 8U | static_cast<unsigned char>(packet[from + n]);
      return value;
    };
    const std::uint64_t time = little_endian(6, 8);
    if (at > 0) {
      EXPECT_EQ(time - before, 10'000'000U);
    }
    before = time;
    const auto number = [&](std::size_t from) {
      return std::bit_cast<float>(static_cast<std::uint32_t>(little_endian(from, 4)));
    };
    EXPECT_EQ(number(14), 0.0F);
    EXPECT_EQ(number(22), 9.81F);
    EXPECT_EQ(number(26), 23.0F);
  }
}

TEST_F(VectorNavFirmwareTest, RepliesComeBetweenTheStreams) {
  ask("VNWRG,07,200");
  ask("VNWRG,06,11");
  ask("VNWRG,75,1,4,01,0100");
  host.send("$VNRRG,01*XX\r\n");
  const std::string bytes = host.listen(milliseconds(20));
  EXPECT_THAT(bytes, HasSubstr("$VNRRG,01,VN-100T-CR*"));
  EXPECT_THAT(bytes, HasSubstr("$VNACC,"));
  EXPECT_THAT(bytes, HasSubstr(std::string("\xFA\x01\x00\x01", 4)));
  host.send("$VNASY,0*4F\r\n");
  host.listen(milliseconds(2));
  EXPECT_EQ(host.listen(seconds(1)), "") << "both are paused";
  ask("VNASY,1");
  EXPECT_FALSE(host.listen(seconds(1)).empty());
}

TEST_F(VectorNavFirmwareTest, WhatTheLineCannotCarryIsRefused) {
  ask("VNWRG,05,9600");
  ask("VNWRG,07,100");
  // 34 bytes at 100 Hz are 3400 bytes a second; 9600 baud carry 960.
  EXPECT_EQ(ask("VNWRG,06,11"), "VNERR,0C");
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0");
  ask("VNWRG,07,20");
  EXPECT_EQ(ask("VNWRG,06,11"), "VNWRG,06,11");
  ask("VNASY,0");
  EXPECT_EQ(ask("VNWRG,75,1,1,01,0100"), "VNERR,0C");
  EXPECT_EQ(ask("VNRRG,75"), "VNRRG,75,0,1,00");
}

// Configuration that the public ROS driver writes by default, also to a VN-100: groups common, time,
// attitude, INS.
TEST_F(VectorNavFirmwareTest, TakesTheOutputsOfTheRosDriver) {
  const std::string command = "VNWRG,75,1,20,33,578,4C,100,69D";
  EXPECT_EQ(ask(command), command);
  const std::string bytes = host.listen(seconds(1));
  constexpr std::size_t kPacket = 208;
  ASSERT_EQ(bytes.size(), 40 * kPacket);
  for (std::size_t at = 0; at < bytes.size(); at += kPacket) {
    const std::string packet = bytes.substr(at, kPacket);
    EXPECT_EQ(packet.substr(0, 10), std::string("\xFA\x33\x78\x05\x4C\x00\x00\x01\x9D\x06", 10));
    EXPECT_EQ(crc(packet.substr(1)), 0U);
  }
  // Common: yaw pitch roll 12, quaternion 16, rate 12, position 24, then the acceleration.
  const std::size_t z = 10 + 12 + 16 + 12 + 24 + 8;
  EXPECT_EQ(bytes.substr(z, 4), std::string("\xC3\xF5\x1C\x41", 4));  // 9.81F
  EXPECT_EQ(ask("VNWRG,76,0,1,0"), "VNWRG,76,0,1,0");
}

TEST_F(VectorNavFirmwareTest, TheRegistersThatConfigurationToolsDumpAreThere) {
  for (const auto& [reg, values] : std::vector<std::pair<unsigned, std::size_t>>{
           {9, 4},  {15, 13}, {21, 6},  {22, 10}, {23, 12}, {24, 4},  {25, 12}, {26, 9}, {30, 7},
           {32, 9}, {33, 3},  {34, 7},  {35, 4},  {36, 9},  {37, 9},  {38, 9},  {39, 9}, {40, 9},
           {43, 3}, {44, 3},  {47, 12}, {48, 2},  {50, 3},  {51, 3},  {52, 9},  {74, 7}, {80, 7},
           {82, 5}, {83, 9},  {84, 12}, {85, 10}, {227, 4}, {239, 9}, {240, 9}}) {
    const std::string answer = ask(fmt::format("VNRRG,{:02}", reg));
    EXPECT_THAT(answer, StartsWith(fmt::format("VNRRG,{:02},", reg)));
    EXPECT_EQ(numbers_of(answer).size(), values + 1) << answer;
  }
  EXPECT_EQ(ask("VNRRG,58"), "VNERR,08") << "a VN-100 has no GNSS";
}

TEST_F(VectorNavFirmwareTest, WhatIsReadOfARegisterCanBeWrittenBack) {
  for (const unsigned reg :
       {21U, 23U, 24U, 25U, 26U, 32U, 35U, 36U, 44U, 51U, 74U, 82U, 83U, 84U, 85U, 227U}) {
    const std::string read = ask(fmt::format("VNRRG,{:02}", reg));
    const std::string values = read.substr(std::string("VNRRG,").size());
    EXPECT_EQ(ask("VNWRG," + values), "VNWRG," + values);
    EXPECT_EQ(ask(fmt::format("VNRRG,{:02}", reg)), read);
  }
  EXPECT_EQ(ask("VNWRG,32,3,0,0,0,6,1,0,1.5,0"), "VNERR,07");
  EXPECT_EQ(ask("VNWRG,47,1,0,0,0,1,0,0,0,1,0,0,0"), "VNERR,09");
}

TEST_F(VectorNavFirmwareTest, TheCommandsOfItsFilterAreTaken) {
  EXPECT_EQ(ask("VNTAR"), "VNTAR");
  EXPECT_EQ(ask("VNSGB"), "VNSGB");
  EXPECT_EQ(ask("VNKMD,1"), "VNKMD,1");
  EXPECT_EQ(ask("VNKAD,0"), "VNKAD,0");
  EXPECT_EQ(ask("VNKAD"), "VNERR,05");
  EXPECT_EQ(ask("VNKMD,7"), "VNERR,07");
}

TEST_F(VectorNavFirmwareTest, WhatItDoesNotKnowIsNotedOnce) {
  ask("VNFWU");
  ask("VNFWU");
  ask("VNRRG,99");
  const auto unserved = firmware.unserved().all();
  ASSERT_EQ(unserved.size(), 2U);
  EXPECT_EQ(unserved[0].command, "VNFWU");
  EXPECT_EQ(unserved[0].count, 2U);
  EXPECT_THAT(unserved[0].bytes, StartsWith("$VNFWU*"));
  EXPECT_EQ(unserved[1].command, "VNRRG,99");
  EXPECT_EQ(unserved[1].reaction, "refused: VNERR,08");
}

TEST_F(VectorNavFirmwareTest, WhatTheOtherPortWouldOutputIsNoted) {
  EXPECT_EQ(ask("VNWRG,75,2,8,01,0100"), "VNWRG,75,2,8,01,0100");
  EXPECT_EQ(host.listen(seconds(1)), "");
  EXPECT_EQ(ask("VNWRG,07,10,2"), "VNWRG,07,10,2");
  EXPECT_EQ(ask("VNWRG,06,0,2"), "VNWRG,06,0,2");
  const auto unserved = firmware.unserved().all();
  ASSERT_EQ(unserved.size(), 1U);
  EXPECT_EQ(unserved[0].command, "VNWRG,75,2,8,01,0100");
  EXPECT_THAT(unserved[0].reaction, HasSubstr("serial port 2 is not wired"));
}

TEST_F(VectorNavFirmwareTest, OutputThatTheLineCannotCarryIsNoted) {
  ask("VNWRG,05,9600");
  EXPECT_EQ(ask("VNWRG,06,19"), "VNERR,0C");
  ASSERT_EQ(firmware.unserved().all().size(), 1U);
  EXPECT_EQ(firmware.unserved().all()[0].reaction, "more output than 9600 Bd carry: VNERR,0C");
}

class VectorNavPort2Test : public VectorNavFirmwareTest {
 protected:
  VectorNavPort2Test()
      : VectorNavFirmwareTest([] {
          VectorNavSettings settings = quiet();
          settings.serial_port = 2;
          return settings;
        }()) {}
};

// imu_vn_100 sends the binary output of its readings to serial port 2.
TEST_F(VectorNavPort2Test, ServesTheOutputsOfSerialPort2) {
  EXPECT_EQ(ask("VNWRG,75,2,8,01,0100"), "VNWRG,75,2,8,01,0100");
  const std::string packets = host.listen(seconds(1));
  EXPECT_EQ(packets.size(), 100U * (4 + 12 + 2));
  EXPECT_EQ(ask("VNWRG,75,1,8,01,0100"), "VNWRG,75,1,8,01,0100");
  EXPECT_EQ(host.listen(seconds(1)), "") << "port 1";
  EXPECT_EQ(ask("VNWRG,06,11"), "VNWRG,06,11");
  EXPECT_EQ(ask("VNASY,0"), "VNASY,0");
  EXPECT_EQ(ask("VNRRG,06,2"), "VNRRG,06,11");
  EXPECT_EQ(ask("VNRRG,06,1"), "VNRRG,06,0");
  host.send("$VNWRG,05,9600,1*XX\r\n");
  host.listen(milliseconds(1));
  EXPECT_EQ(firmware.line_speed(), 115200U);
}

TEST_F(VectorNavFirmwareTest, ANewBaudRateHoldsFromTheEndOfItsAnswerOn) {
  EXPECT_EQ(firmware.line_speed(), 115200U);
  host.send("$VNWRG,05,921600*XX\r\n");
  EXPECT_EQ(firmware.line_speed(), 115200U);
  EXPECT_THAT(host.listen(milliseconds(1)), StartsWith("$VNWRG,05,921600"));
  EXPECT_EQ(firmware.line_speed(), 921600U);
  ask("VNRST");
  host.listen(seconds(1));
  EXPECT_EQ(firmware.line_speed(), 115200U) << "it was not saved";
}

TEST_F(VectorNavFirmwareTest, ANewSessionStartsWithAnEmptyLine) {
  host.send("$VNWRG,06");
  firmware.session_starts();
  EXPECT_EQ(raw(",1*XX\r\n"), "");
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0");
}

TEST(VectorNavFamilyTest, AVn200HasTheRegistersOfItsReceiver) {
  VectorNavSettings settings;
  settings.model = "VN-200T-CR";
  settings.async_type = 0;
  VectorNavFirmware firmware(std::make_shared<SimBench>(BenchTruth{}), settings);
  FirmwareHost host(firmware);
  EXPECT_THAT(host.exchange("$VNRRG,58*XX\r\n"), StartsWith("$VNRRG,58,"));
  EXPECT_THAT(host.exchange("$VNRRG,01*XX\r\n"), StartsWith("$VNRRG,01,VN-200T-CR"));
}

TEST_F(VectorNavFirmwareTest, ItsOwnCalibrationIsApplied) {
  ask("VNWRG,25,1,0,0,0,1,0,0,0,2,0,0,1");
  EXPECT_EQ(ask("VNRRG,18"), "VNRRG,18,+00.000,+00.000,+17.620");  // 2 (9.81 - 1)
}

TEST(VectorNavFirmwareAtPowerOnTest, StreamsAsItLeavesTheFactory) {
  VectorNavFirmware firmware(std::make_shared<SimBench>(BenchTruth{}));
  FirmwareHost host(firmware);
  const auto lines = lines_of(host.listen(seconds(1)));
  ASSERT_EQ(lines.size(), 40U);
  for (const std::string& line : lines) EXPECT_THAT(line, StartsWith("$VNYMR,"));
  // The line has the length of one recorded from a real device.
  EXPECT_EQ(lines[0].size(),
            std::string_view("$VNYMR,-165.970,-037.299,+001.252,+00.2894,+00.0706,+00.7482,-05.961,"
                             "-00.184,-07.853,+00.000885,-00.000192,-00.000642*69")
                .size());
}

TEST(VectorNavFirmwareAtPowerOnTest, SettingsItDoesNotHaveAreRefused) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  const auto with = [&](auto change) {
    VectorNavSettings settings;
    change(settings);
    return VectorNavFirmware(bench, settings);
  };
  EXPECT_THROW(with([](VectorNavSettings& s) { s.baud = 1; }), std::invalid_argument);
  EXPECT_THROW(with([](VectorNavSettings& s) { s.async_type = 3; }), std::invalid_argument);
  EXPECT_THROW(with([](VectorNavSettings& s) { s.async_rate_hz = 3; }), std::invalid_argument);
}

TEST(VectorNavFirmwareAtPowerOnTest, AFaultyWorldMakesNoReadings) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  bench->inject({.kind = FaultKind::kNoOutput});
  VectorNavFirmware firmware(bench);
  FirmwareHost host(firmware);
  EXPECT_EQ(host.listen(seconds(1)), "");
  EXPECT_THAT(host.exchange("$VNRRG,01*XX\r\n"), StartsWith("$VNRRG,01,"));
}

TEST_F(VectorNavFirmwareTest, GyroMagnetometerAndAttitudeFollowTheStage) {
  // z up is a roll of 180 degrees: z of this instrument points down where it is mounted as the maker draws
  // it.
  EXPECT_EQ(ask("VNRRG,08"), "VNRRG,08,+000.000,+000.000,+180.000");
  bench->move(StageAxis::kX, Angle::degrees(90.0), host.clock().now());
  host.listen(seconds(1));
  EXPECT_EQ(ask("VNRRG,19"), "VNRRG,19,+00.349066,+00.000000,+00.000000");
  const std::vector<double> delta = numbers_of(ask("VNRRG,80"));
  EXPECT_NEAR(delta.at(2), 20.0 / 800.0, 1e-6) << "degrees in a period of the IMU";
  host.listen(seconds(10));
  EXPECT_EQ(ask("VNRRG,08"), "VNRRG,08,+000.000,+000.000,-090.000");
  const std::vector<double> quaternion = numbers_of(ask("VNRRG,09"));
  EXPECT_NEAR(quaternion.at(1), -0.707107, 1e-6);
  EXPECT_NEAR(quaternion.at(4), 0.707107, 1e-6) << "the scalar comes last";
  const std::vector<double> all = numbers_of(ask("VNRRG,20"));
  EXPECT_NEAR(all.at(1), 0.25, 1e-4);
  EXPECT_NEAR(all.at(2), -0.45, 1e-4);
  EXPECT_NEAR(all.at(5), 9.81, 1e-3) << "up, along y now";
  // Along north, east, down it is -g whatever the attitude.
  const std::vector<double> inertial = numbers_of(ask("VNRRG,240"));
  EXPECT_NEAR(inertial.at(4), 0.0, 1e-3);
  EXPECT_NEAR(inertial.at(6), -9.81, 1e-3);
}

TEST_F(VectorNavFirmwareTest, BinaryFieldsOfMotionAreThoseOfTheText) {
  bench->move(StageAxis::kX, Angle::degrees(90.0), host.clock().now());
  host.listen(seconds(1));
  // Common: yaw pitch roll, quaternion, rate; IMU: gyro; attitude: field and acceleration in NED. One packet.
  EXPECT_EQ(ask("VNWRG,75,0,1,15,0038,0008,0030"), "VNWRG,75,0,1,15,0038,0008,0030");
  const std::string bytes = raw("$VNBOM,1*XX\r\n");
  const std::size_t start = bytes.find('\xFA');
  ASSERT_NE(start, std::string::npos) << bytes;
  const std::size_t payload = start + 8;
  const auto value = [&](std::size_t n) {
    std::uint32_t bits = 0;
    for (std::size_t k = 0; k < 4; ++k)
      bits |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes.at(payload + 4 * n + k))) << 8 * k;
    return std::bit_cast<float>(bits);
  };
  EXPECT_NEAR(value(2), -162.5F, 0.1F) << "180 degrees and 17.5 more: 1 s at 20 deg/s after 0.25 s of ramp";
  EXPECT_FLOAT_EQ(value(7), 0.34906585F);
  EXPECT_FLOAT_EQ(value(10), 0.34906585F);
  EXPECT_NEAR(value(13), 0.25F, 1e-6F) << "north";
  EXPECT_NEAR(value(15), 0.45F, 1e-6F) << "down";
  EXPECT_NEAR(value(18), -9.81F, 1e-4F);
}

TEST_F(VectorNavFirmwareTest, WithoutPowerItForgetsWhatWasNotSaved) {
  EXPECT_EQ(ask("VNWRG,05,921600"), "VNWRG,05,921600");
  EXPECT_EQ(ask("VNWRG,06,1"), "VNWRG,06,1");
  EXPECT_NE(host.listen(seconds(1)), "");
  firmware.power(false, host.clock().now());
  EXPECT_EQ(host.listen(seconds(1)), "");
  firmware.power(true, host.clock().now());
  host.listen(seconds(1));
  EXPECT_EQ(firmware.line_speed(), 115200U);
  EXPECT_EQ(ask("VNRRG,06"), "VNRRG,06,0");
}

}  // namespace
}  // namespace abcal::sim
