#include "sim/firmware/mip_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::ElementsAre;

std::string from_hex(std::string_view hex) {
  std::string bytes;
  std::string digits;
  for (const char c : hex) {
    if (c == ' ') continue;
    digits.push_back(c);
    if (digits.size() == 2) {
      bytes.push_back(static_cast<char>(std::stoi(digits, nullptr, 16)));
      digits.clear();
    }
  }
  return bytes;
}

std::string to_hex(std::string_view bytes) {
  std::string hex;
  for (const char c : bytes) {
    constexpr char kDigits[] = "0123456789ABCDEF";
    hex.push_back(kDigits[static_cast<unsigned char>(c) >> 4U]);
    hex.push_back(kDigits[static_cast<unsigned char>(c) & 15U]);
  }
  return hex;
}

struct Field {
  unsigned set;
  unsigned descriptor;
  std::string data;
};

/// Reads whole packets; anything else fails the test.
std::vector<Field> fields_of(const std::string& bytes) {
  std::vector<Field> fields;
  const auto byte = [&](std::size_t at) {
    return static_cast<unsigned>(static_cast<unsigned char>(bytes.at(at)));
  };
  for (std::size_t at = 0; at < bytes.size();) {
    EXPECT_EQ(byte(at), 0x75U);
    EXPECT_EQ(byte(at + 1), 0x65U);
    const std::size_t end = at + 4 + byte(at + 3);
    unsigned a = 0;
    unsigned b = 0;
    for (std::size_t n = at; n < end; ++n) b = (b + (a = (a + byte(n)) % 256)) % 256;
    EXPECT_EQ(byte(end), a);
    EXPECT_EQ(byte(end + 1), b);
    for (std::size_t f = at + 4; f < end; f += byte(f))
      fields.push_back({byte(at + 2), byte(f + 1), bytes.substr(f + 2, byte(f) - 2)});
    at = end + 2;
  }
  return fields;
}

std::uint64_t big_endian(const std::string& data, std::size_t at, std::size_t count) {
  std::uint64_t value = 0;
  for (std::size_t n = 0; n < count; ++n) value = value << 8U | static_cast<unsigned char>(data.at(at + n));
  return value;
}

float as_float(const std::string& data, std::size_t which) {
  return std::bit_cast<float>(static_cast<std::uint32_t>(big_endian(data, 4 * which, 4)));
}

std::string command(unsigned set, const std::string& field_hex) {
  std::string payload = from_hex(field_hex);
  std::string bytes = from_hex("7565");
  bytes.push_back(static_cast<char>(set));
  bytes.push_back(static_cast<char>(payload.size()));
  bytes += payload;
  unsigned a = 0;
  unsigned b = 0;
  for (const char c : bytes) b = (b + (a = (a + static_cast<unsigned char>(c)) % 256)) % 256;
  bytes.push_back(static_cast<char>(a));
  bytes.push_back(static_cast<char>(b));
  return bytes;
}

class MipFirmwareTest : public testing::Test {
 protected:
  explicit MipFirmwareTest(MipSettings settings = {}, BenchTruth truth = {})
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  /// Sends bytes written in hexadecimal, checksum and all.
  std::string raw(std::string_view hex) { return to_hex(host.exchange(from_hex(hex))); }
  std::vector<Field> ask(unsigned set, const std::string& field_hex) {
    return fields_of(host.exchange(command(set, field_hex)));
  }
  /// The code with which a command is answered.
  unsigned code(unsigned set, const std::string& field_hex) {
    const auto answer = ask(set, field_hex);
    if (answer.empty() || answer[0].descriptor != 0xF1) return 999;
    EXPECT_EQ(answer[0].set, set);
    return static_cast<unsigned char>(answer[0].data.at(1));
  }

  std::shared_ptr<SimBench> bench;
  MipFirmware firmware;
  FirmwareHost host;
};

TEST_F(MipFirmwareTest, TheMakersFramesGetTheMakersAnswers) {
  EXPECT_EQ(raw("756501020201E0C6"), "7565010404F10100D56A");                    // ping
  EXPECT_EQ(raw("756501020202E1C7"), "7565010404F10200D66C");                    // idle
  EXPECT_EQ(raw("75650C0303 30 05 2147").substr(0, 16), "75650C0404F13000");     // load defaults
  EXPECT_EQ(raw("75650C020206F0F7").substr(0, 24), "75650C0804F10600048303E8");  // base rate 1000 Hz
}

TEST_F(MipFirmwareTest, TheLegacyHostGetsWhatItAsksFor) {
  raw("756501020202E1C7");
  const auto info = fields_of(host.exchange(from_hex("756501020203E2C8")));
  ASSERT_EQ(info.size(), 2U);
  EXPECT_EQ(to_hex(info[0].data), "0300");
  EXPECT_EQ(info[1].descriptor, 0x81U);
  ASSERT_EQ(info[1].data.size(), 82U);
  EXPECT_EQ(big_endian(info[1].data, 0, 2), 1103U);
  EXPECT_EQ(info[1].data.substr(2, 16), "      3DM-GV7-AR");
  EXPECT_EQ(info[1].data.substr(34, 16), "     6284.123456");

  const auto descriptors = fields_of(host.exchange(from_hex("756501020204E3C9")));
  ASSERT_EQ(descriptors.size(), 2U);
  EXPECT_EQ(descriptors[1].descriptor, 0x82U);
  std::vector<std::uint64_t> list;
  for (std::size_t n = 0; n < descriptors[1].data.size(); n += 2)
    list.push_back(big_endian(descriptors[1].data, n, 2));
  for (const std::uint64_t known :
       {0x0101U, 0x0102U, 0x0103U, 0x0106U, 0x0C06U, 0x0C08U, 0x0C0FU, 0x8004U, 0x80D5U})
    EXPECT_THAT(list, testing::Contains(known));

  const auto rate = fields_of(host.exchange(from_hex("75650C020206F0F7")));
  ASSERT_EQ(rate.size(), 2U);
  EXPECT_EQ(rate[1].descriptor, 0x83U);
  EXPECT_EQ(big_endian(rate[1].data, 0, 2), 1000U);

  // Acceleration and gyro at base rate / 500, then resume: 2 packets a second.
  EXPECT_EQ(raw("75650C0A0A0801020401F40501F4F839").substr(0, 16), "75650C0404F10800");
  EXPECT_EQ(raw("756501020206E5CB"), "7565010404F10600DA74");
  const auto data = fields_of(host.listen(seconds(3)));
  ASSERT_EQ(data.size(), 12U);
  EXPECT_EQ(data[0].set, 0x80U);
  EXPECT_EQ(data[0].descriptor, 0x04U);
  EXPECT_EQ(data[1].descriptor, 0x05U);
  EXPECT_EQ(as_float(data[0].data, 0), 0.0F);
  EXPECT_EQ(as_float(data[0].data, 2), 1.0F);  // g
}

TEST_F(MipFirmwareTest, TheModernHostGetsWhatItAsksFor) {
  const auto rate = fields_of(host.exchange(from_hex("75650C03030E807A7E")));
  ASSERT_EQ(rate.size(), 2U);
  EXPECT_EQ(rate[1].descriptor, 0x8EU);
  EXPECT_EQ(to_hex(rate[1].data), "8003E8");
  EXPECT_EQ(raw("75650C0B0B0F0180020401F40501F48199").substr(0, 16), "75650C0404F10F00");
  EXPECT_EQ(raw("75650C0E 0E0F018003 D5000A 04000A 05000A 91CE").substr(0, 16), "75650C0404F10F00");
  const auto format = ask(0x0C, "040F0280");
  ASSERT_EQ(format.size(), 2U);
  EXPECT_EQ(format[1].descriptor, 0x8FU);
  EXPECT_EQ(to_hex(format[1].data), "8003D5000A04000A05000A");
  EXPECT_EQ(code(0x0C, "0511018001"), 0U);  // stream on: that ends the idle state too
  const auto data = fields_of(host.listen(milliseconds(100)));
  ASSERT_EQ(data.size(), 30U);
  EXPECT_EQ(data[0].descriptor, 0xD5U);
  EXPECT_EQ(data[1].descriptor, 0x04U);
  // The reference time is that of the grid: 10 ms apart, whole.
  const std::uint64_t first = big_endian(data[0].data, 0, 8);
  EXPECT_EQ(first % 10'000'000U, 0U);
  EXPECT_EQ(big_endian(data[27].data, 0, 8) - first, 90'000'000U);
}

TEST_F(MipFirmwareTest, ThePollGivesOnePacketAfterItsAcknowledgement) {
  const auto answer = fields_of(host.exchange(from_hex("75650C08 080D008003D50405 6446")));
  ASSERT_EQ(answer.size(), 4U);
  EXPECT_EQ(to_hex(answer[0].data), "0D00");
  EXPECT_EQ(answer[1].set, 0x80U);
  EXPECT_EQ(answer[1].descriptor, 0xD5U);
  EXPECT_EQ(answer[2].descriptor, 0x04U);
  // The other form in use, with a reserved word, and with the acknowledgement suppressed.
  const auto silent = ask(0x0C, "080D018001040000");
  ASSERT_EQ(silent.size(), 1U);
  EXPECT_EQ(silent[0].descriptor, 0x04U);
  EXPECT_EQ(code(0x0C, "060D00800199"), 3U);
}

TEST_F(MipFirmwareTest, SeveralFieldsInOnePacketAreAnsweredInOne) {
  const auto answer = ask(0x01, "080901010001C200 0201");  // comm speed and ping
  ASSERT_EQ(answer.size(), 2U);
  EXPECT_EQ(to_hex(answer[0].data), "0900");
  EXPECT_EQ(to_hex(answer[1].data), "0100");
}

TEST_F(MipFirmwareTest, UnknownCommandsAndParametersAreRefusedWithTheirCodes) {
  EXPECT_EQ(code(0x01, "0255"), 1U);
  EXPECT_EQ(code(0x0C, "02EE"), 1U);
  EXPECT_EQ(code(0x77, "0201"), 1U);
  EXPECT_EQ(code(0x0C, "080F01800199000A"), 3U);  // no such field
  EXPECT_EQ(code(0x0C, "080F018001040000"), 3U);  // decimation 0
  EXPECT_EQ(code(0x0C, "040F0183"), 3U);          // no such set
  EXPECT_EQ(code(0x0C, "030F01"), 3U);            // too short
  EXPECT_EQ(code(0x01, "0301FF"), 3U);            // too long
  EXPECT_EQ(code(0x0C, "033009"), 3U);            // no such function
}

TEST_F(MipFirmwareTest, AWrongChecksumIsRefusedAndTheNextPacketIsFound) {
  EXPECT_EQ(raw("756501020201E0C7"), to_hex(command(0x01, "04F10102")));
  EXPECT_EQ(raw("00FF7575 756501020201E0C6 42"), "7565010404F10100D56A");
  host.send(from_hex("7565010202"));
  host.send(from_hex("01E0"));
  EXPECT_EQ(raw("C6"), "7565010404F10100D56A");
}

TEST_F(MipFirmwareTest, APacketThatDoesNotEndIsGivenUp) {
  host.send(from_hex("756501FF0102"));
  host.listen(seconds(1));
  EXPECT_EQ(raw("756501020201E0C6"), "7565010404F10100D56A");
}

TEST_F(MipFirmwareTest, IdleStopsTheStreamAndResumeGoesOn) {
  EXPECT_EQ(host.listen(seconds(1)), "");  // idle at power on
  EXPECT_EQ(code(0x01, "0206"), 0U);
  EXPECT_EQ(fields_of(host.listen(seconds(1))).size(), 200U);  // as it left the factory: 100 Hz, two fields
  const auto last = ask(0x01, "0202");
  EXPECT_EQ(to_hex(last.back().data), "0200");
  EXPECT_EQ(host.listen(seconds(1)), "");
  EXPECT_EQ(code(0x0C, "0511018000"), 0U);  // stream off
  EXPECT_EQ(code(0x01, "0206"), 0U);
  EXPECT_EQ(host.listen(seconds(1)), "");
}

TEST_F(MipFirmwareTest, CommandsAreAnsweredWhileDataStream) {
  EXPECT_EQ(code(0x0C, "080F018001040001"), 0U);
  EXPECT_EQ(code(0x01, "0206"), 0U);
  host.send(command(0x01, "0201"));
  std::vector<unsigned> sets;
  for (const Field& field : fields_of(host.listen(milliseconds(3)))) sets.push_back(field.set);
  EXPECT_THAT(sets, ElementsAre(0x01U, 0x80U, 0x80U, 0x80U));
}

TEST_F(MipFirmwareTest, EveryFieldHasItsOwnDecimation) {
  EXPECT_EQ(code(0x0C, "0E0F018003 04000A 140064 180032"), 0U);
  EXPECT_EQ(code(0x01, "0206"), 0U);
  host.listen(milliseconds(1000) - (host.clock().now() - Clock::Instant{}));
  int accelerations = 0;
  int temperatures = 0;
  int over_ranges = 0;
  for (const Field& field : fields_of(host.listen(seconds(1)))) {
    accelerations += field.descriptor == 0x04;
    temperatures += field.descriptor == 0x14;
    over_ranges += field.descriptor == 0x18;
    if (field.descriptor == 0x14) {
      EXPECT_EQ(as_float(field.data, 2), 23.0F);
    }
  }
  EXPECT_EQ(accelerations, 100);
  EXPECT_EQ(temperatures, 10);
  EXPECT_EQ(over_ranges, 20);
}

TEST_F(MipFirmwareTest, SettingsAreReadBackSavedLoadedAndReset) {
  EXPECT_EQ(code(0x0C, "080F018001040005"), 0U);
  EXPECT_EQ(to_hex(ask(0x0C, "040F0280").back().data), "8001040005");
  EXPECT_EQ(to_hex(ask(0x0C, "030802").back().data), "01040005");  // the legacy name of the same
  EXPECT_EQ(code(0x0C, "033003"), 0U);                             // save
  EXPECT_EQ(code(0x0C, "080F018001040007"), 0U);
  EXPECT_EQ(code(0x0C, "033004"), 0U);  // load
  EXPECT_EQ(to_hex(ask(0x0C, "040F0280").back().data), "8001040005");
  EXPECT_EQ(code(0x0C, "033005"), 0U);  // reset
  EXPECT_EQ(to_hex(ask(0x0C, "040F0280").back().data), "800204000AD5000A");
  EXPECT_EQ(code(0x01, "027E"), 0U);  // a restart: what was saved
  EXPECT_EQ(to_hex(ask(0x0C, "040F0280").back().data), "8001040005");
  EXPECT_EQ(to_hex(ask(0x0C, "04110280").back().data), "8001");
  EXPECT_EQ(code(0x0C, "0511018000"), 0U);
  EXPECT_EQ(to_hex(ask(0x0C, "04110280").back().data), "8000");
}

TEST_F(MipFirmwareTest, TheBaudRateIsWrittenAndReadInBothForms) {
  EXPECT_EQ(code(0x01, "080901010001C200"), 0U);
  EXPECT_EQ(to_hex(ask(0x01, "04090201").back().data), "010001C200");
  EXPECT_EQ(code(0x0C, "074001000E1000"), 0U);  // 921600
  EXPECT_EQ(ask(0x0C, "034002").back().descriptor, 0x87U);
  EXPECT_EQ(to_hex(ask(0x0C, "034002").back().data), "000E1000");
  EXPECT_EQ(code(0x0C, "07400100000001"), 3U);
}

// The order of the maker's example for this unit: without any of these it gives up.
TEST_F(MipFirmwareTest, AnswersTheMakersFilterExampleOfThe7Series) {
  EXPECT_EQ(code(0x01, "0202"), 0U);
  EXPECT_EQ(code(0x0C, "0330 05"), 0U);
  host.send(command(0x0C, "0439 03E8"));  // capture of the gyro bias, 1 s
  EXPECT_EQ(host.listen(milliseconds(999)), "");
  const auto bias = fields_of(host.listen(milliseconds(10)));
  ASSERT_EQ(bias.size(), 2U);
  EXPECT_EQ(to_hex(bias[0].data), "3900");
  EXPECT_EQ(bias[1].descriptor, 0x9BU);
  EXPECT_EQ(bias[1].data.size(), 12U);
  const auto rate = ask(0x0C, "030E 82");
  EXPECT_EQ(to_hex(rate.at(1).data), "8203E8");
  EXPECT_EQ(code(0x0C, "0E0F 01 82 03 D3000A 100064 05000A"), 0U);
  EXPECT_EQ(code(0x0C, "192E 01 01 02 82 05 01 01 BFE0000000000000 3FE0000000000000"), 0U);
  EXPECT_EQ(code(0x0C, "0A2F 01 01 01 02 82 0001 00"), 0U);
  EXPECT_EQ(code(0x0C, "052B 01 01 01"), 0U);
  EXPECT_EQ(code(0x0C, "0F31 01 00000000 00000000 00000000"), 0U);
  EXPECT_EQ(code(0x0D, "0201"), 0U);
  EXPECT_EQ(code(0x0C, "0511 01 82 01"), 0U);
  EXPECT_EQ(code(0x0C, "0511 01 80 00"), 0U);
  EXPECT_EQ(code(0x01, "0206"), 0U);
  std::vector<unsigned> states;
  for (const Field& field : fields_of(host.listen(seconds(2)))) {
    EXPECT_EQ(field.set, 0x82U);
    if (field.descriptor == 0x10) states.push_back(static_cast<unsigned>(big_endian(field.data, 0, 2)));
    if (field.descriptor == 0x05) {
      EXPECT_EQ(field.data.size(), 14U);
    }
  }
  ASSERT_EQ(states.size(), 20U);
  EXPECT_EQ(states.front(), 1U);
  EXPECT_EQ(states.back(), 2U) << "the host waits for this";
}

class MipArTest : public MipFirmwareTest {
 protected:
  MipArTest() : MipFirmwareTest({.magnetometer = false}) {}
};

TEST_F(MipArTest, AnAttitudeReferenceHasNoMagnetometer) {
  const auto answer = ask(0x01, "0204");
  std::vector<std::uint64_t> descriptors;
  for (std::size_t at = 0; at < answer.at(1).data.size(); at += 2)
    descriptors.push_back(big_endian(answer[1].data, at, 2));
  EXPECT_THAT(descriptors, testing::Contains(0x8004U));
  EXPECT_THAT(descriptors, testing::Contains(0x8210U));
  EXPECT_THAT(descriptors, testing::Contains(0x0C39U));
  EXPECT_THAT(descriptors, testing::Not(testing::Contains(0x8006U)));
  EXPECT_LT(descriptors.size(), 125U);  // more would be in a second list
  EXPECT_EQ(code(0x0C, "080F 01 80 01 060001"), 3U);
}

TEST_F(MipFirmwareTest, EveryCommandThatItListsIsKnown) {
  const std::string list = ask(0x01, "0204").at(1).data;
  for (std::size_t at = 0; at < list.size(); at += 2) {
    const auto set = static_cast<unsigned>(big_endian(list, at, 1));
    if (set >= 0x80) continue;
    const std::string command = to_hex(list.substr(at + 1, 1));
    // Without parameters most are refused, but not as unknown.
    if (command != "7E") {
      EXPECT_NE(code(set, "02" + command), 1U) << set << " " << command;
    }
  }
}

TEST_F(MipFirmwareTest, ItsAccelerometerBiasIsSubtracted) {
  const auto z = [&] { return as_float(ask(0x0C, "060D 80 00 01 04").at(1).data, 2); };
  EXPECT_EQ(z(), 1.0F);
  EXPECT_EQ(to_hex(ask(0x0C, "0337 02").at(1).data), "000000000000000000000000");
  EXPECT_EQ(code(0x0C, "0F37 01 00000000 00000000 3E800000"), 0U);  // 0.25 g
  EXPECT_EQ(z(), 0.75F);
  const auto read = ask(0x0C, "0337 02");
  EXPECT_EQ(read.at(1).descriptor, 0x9AU);
  EXPECT_EQ(to_hex(read[1].data), "00000000000000003E800000");
  EXPECT_EQ(code(0x0C, "0F37 01 7FC00000 00000000 00000000"), 3U) << "not a number";
  EXPECT_EQ(to_hex(ask(0x0C, "0337 02").at(1).data), "00000000000000003E800000");
  EXPECT_EQ(code(0x0C, "0337 05"), 0U);
  EXPECT_EQ(z(), 1.0F);
}

TEST_F(MipFirmwareTest, WhatItDoesNotKnowIsNotedOnce) {
  EXPECT_EQ(code(0x0C, "0377 02"), 1U);
  EXPECT_EQ(code(0x0C, "0377 02"), 1U);
  EXPECT_EQ(code(0x13, "0201"), 1U);
  const auto unserved = firmware.unserved().all();
  ASSERT_EQ(unserved.size(), 2U);
  EXPECT_EQ(unserved[0].command, "0C,77");
  EXPECT_EQ(unserved[0].count, 2U);
  EXPECT_EQ(unserved[1].command, "13,01");
}

TEST_F(MipFirmwareTest, ANewBaudRateHoldsFromTheEndOfItsAnswerOn) {
  host.send(command(0x0C, "0740 01 000E1000"));
  EXPECT_EQ(firmware.line_speed(), 115200U);
  EXPECT_EQ(fields_of(host.listen(milliseconds(1))).size(), 1U);
  EXPECT_EQ(firmware.line_speed(), 921600U);
}

TEST_F(MipFirmwareTest, ANewSessionStartsWithAnEmptyBuffer) {
  host.send(from_hex("75650120"));
  firmware.session_starts();
  EXPECT_EQ(code(0x01, "0201"), 0U);
}

class MipAhrsTest : public MipFirmwareTest {
 protected:
  MipAhrsTest()
      : MipFirmwareTest({.model_name = "3DM-GX5-AHRS", .legacy_commands = true, .modern_commands = false}) {}
};

TEST_F(MipAhrsTest, AnswersTheMakersFilterExampleOfThe5Series) {
  EXPECT_EQ(to_hex(ask(0x0C, "020B").at(1).data), "03E8");
  EXPECT_EQ(code(0x0C, "0A0A 01 02 1003E8 05000A"), 0U);
  EXPECT_EQ(code(0x0D, "0418 01 01"), 0U);
  EXPECT_EQ(code(0x0D, "0419 01 01"), 0U);
  EXPECT_EQ(code(0x0D, "0F11 01 00000000 00000000 00000000"), 0U);
  EXPECT_EQ(code(0x0D, "0201"), 0U);
  host.listen(seconds(2));
  const auto status = ask(0x0C, "060D 82 00 01 10");
  EXPECT_EQ(big_endian(status.at(1).data, 0, 2), 2U) << "GX5_RUN_SOLUTION_VALID";
  EXPECT_EQ(code(0x0C, "0708 01 01 060001"), 0U) << "it has a magnetometer";
  EXPECT_EQ(code(0x0C, "052B 01 01 01"), 1U) << "of the 7 series";
}

// The set-up of imu_3dm_gx4, whose sensors and filter stream at 100 Hz.
void expect_set_up_of_imu_3dm_gx4(MipFirmware& firmware, const std::string& model) {
  FirmwareHost gx4(firmware);
  const auto ask_field = [&](unsigned set, const std::string& field_hex) {
    return fields_of(gx4.exchange(command(set, field_hex)));
  };
  for (const std::string field : {"0206", "020B"}) {
    const auto rate = ask_field(0x0C, field);
    ASSERT_EQ(rate.size(), 2U) << model << " " << field;
    EXPECT_EQ(big_endian(rate[1].data, 0, 2), 1000U);
  }
  for (const std::string field :
       {"10 08 01 04 04000A 05000A 06000A 17000A", "10 0A 01 04 03000A 06000A 0A000A 0B000A",
        "05 11 01 01 01", "05 11 01 03 01"}) {
    const auto answer = ask_field(0x0C, field);
    ASSERT_EQ(answer.size(), 1U) << model << " " << field;
    EXPECT_EQ(to_hex(answer[0].data).substr(2), "00") << model << " " << field;
  }
  ask_field(0x01, "0206");
  std::map<unsigned, std::size_t> sizes;
  for (const Field& field : fields_of(gx4.listen(milliseconds(30))))
    sizes[field.set * 256 + field.descriptor] = field.data.size();
  const std::map<unsigned, std::size_t> expected{{0x8004, 12}, {0x8005, 12}, {0x8006, 12}, {0x8017, 4},
                                                 {0x8203, 18}, {0x8206, 14}, {0x820A, 14}, {0x820B, 14}};
  EXPECT_EQ(sizes, expected) << model;
  EXPECT_TRUE(firmware.unserved().all().empty()) << model;
}

TEST_F(MipFirmwareTest, ImuGx4SetsUpEveryModelWithAMagnetometer) {
  expect_set_up_of_imu_3dm_gx4(firmware, "default");
  MipFirmware gx5(bench, {.model_name = "3DM-GX5-AHRS", .modern_commands = false});
  expect_set_up_of_imu_3dm_gx4(gx5, "GX5");
  MipFirmware cv7(bench, {.model_name = "3DM-CV7-AHRS", .legacy_commands = false});
  expect_set_up_of_imu_3dm_gx4(cv7, "CV7");
}

TEST_F(MipFirmwareTest, ARefusedDataFieldIsListedWithItsBytes) {
  EXPECT_EQ(code(0x0C, "07 0A 01 01 99 000A"), 3U);
  const auto unserved = firmware.unserved().all();
  ASSERT_EQ(unserved.size(), 1U);
  EXPECT_EQ(unserved[0].command, "0C,0A 01 01 99 00 0A");
  EXPECT_EQ(unserved[0].reaction, "no data field 99: NACK 03");
  EXPECT_EQ(to_hex(unserved[0].bytes), to_hex(command(0x0C, "07 0A 01 01 99 000A")));
}

TEST_F(MipAhrsTest, TheFilterOfImuGx4IsSetAndReadBack) {
  EXPECT_EQ(code(0x0D, "05 41 01 0003"), 0U);
  EXPECT_EQ(to_hex(ask(0x0D, "03 41 02").at(1).data), "0003");
  EXPECT_EQ(code(0x0D, "05 14 01 FFFE"), 0U);
  EXPECT_EQ(to_hex(ask(0x0D, "03 14 02").at(1).data), "FFFE");
  EXPECT_EQ(code(0x0C, "0F 3A 01 3DCCCCCD 00000000 00000000"), 0U);
  EXPECT_EQ(to_hex(ask(0x0C, "03 3B 02").at(1).data).substr(0, 8), "3F800000");
  // Status: model, selector, 0, time since power on, and the counters of the diagnostic form.
  host.listen(seconds(2));
  const auto status = ask(0x0C, "05 64 1873 02");
  ASSERT_EQ(status.size(), 2U);
  EXPECT_EQ(status[1].descriptor, 0x90U);
  EXPECT_EQ(status[1].data.size(), 73U);
  EXPECT_EQ(big_endian(status[1].data, 7, 4) / 1000, 2U) << "ms";
  EXPECT_EQ(code(0x0C, "05 64 1873 07"), 3U);
}

TEST_F(MipFirmwareTest, TheOlderPollsNameTheirDataSet) {
  const auto answer = ask(0x0C, "07 01 00 01 04 0000");
  ASSERT_EQ(answer.size(), 2U);
  EXPECT_EQ(answer[1].set, 0x80U);
  EXPECT_EQ(answer[1].descriptor, 0x04U);
  EXPECT_EQ(ask(0x0C, "07 03 00 01 05 0000").at(1).set, 0x82U);
}

TEST_F(MipFirmwareTest, TheStreamSeesTheStageTurn) {
  EXPECT_EQ(code(0x0C, "080F018001040001"), 0U);
  EXPECT_EQ(code(0x01, "0206"), 0U);
  bench->move(StageAxis::kX, Angle::degrees(90), host.clock().now());
  const auto data = fields_of(host.listen(seconds(6)));
  ASSERT_GE(data.size(), 5999U);
  EXPECT_NEAR(static_cast<double>(as_float(data.front().data, 2)), 1.0, 1e-6);
  // y up after a quarter turn about X: sin 90 degrees.
  EXPECT_EQ(as_float(data.back().data, 1), 1.0F);
  EXPECT_NEAR(static_cast<double>(as_float(data.back().data, 2)), 0.0, 1e-15);
}

TEST_F(MipFirmwareTest, AFaultyAccelerometerSendsNothingButStillAnswers) {
  EXPECT_EQ(code(0x01, "0206"), 0U);
  bench->inject({.kind = FaultKind::kNoOutput, .at = host.clock().now()});
  EXPECT_EQ(host.listen(seconds(10)), "");
  EXPECT_EQ(code(0x01, "0201"), 0U);
}

class MipOverRangeTest : public MipFirmwareTest {
 protected:
  MipOverRangeTest()
      : MipFirmwareTest({}, [] {
          BenchTruth truth;
          truth.full_scale = 0.5;
          return truth;
        }()) {}
};

TEST_F(MipOverRangeTest, TheOverRangeFieldSaysWhichAxisClips) {
  const auto answer = ask(0x0C, "070D0080020418");
  ASSERT_EQ(answer.size(), 3U);
  EXPECT_EQ(as_float(answer[1].data, 2), 0.5F);
  EXPECT_EQ(to_hex(answer[2].data), "0004");
}

class MipLegacyOnlyTest : public MipFirmwareTest {
 protected:
  MipLegacyOnlyTest() : MipFirmwareTest({.modern_commands = false, .streaming_at_power_on = true}) {}
};

TEST_F(MipLegacyOnlyTest, AnOldDeviceDoesNotKnowTheModernCommands) {
  EXPECT_NE(host.listen(seconds(1)), "");  // its stream was left on
  EXPECT_EQ(code(0x01, "0202"), 0U);
  EXPECT_EQ(code(0x0C, "030E80"), 1U);
  EXPECT_EQ(code(0x0C, "080F018001040001"), 1U);
  EXPECT_EQ(code(0x0C, "0708010104000A"), 0U);
  EXPECT_EQ(code(0x0C, "0511010101"), 0U);  // the legacy name of the stream
  EXPECT_EQ(fields_of(host.listen(seconds(1))).size(), 100U);
}

TEST(MipSettingsTest, RefusesTextsAndRatesThatDoNotFit) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  EXPECT_THROW(MipFirmware(bench, {.serial_number = "seventeen letters"}), std::invalid_argument);
  EXPECT_THROW(MipFirmware(bench, {.base_rate_hz = 0}), std::invalid_argument);
}

// While X turns, the gyro shows its rate, and the filter its angle; both are known from the world.
TEST_F(MipFirmwareTest, GyroMagnetometerAndFilterFollowTheStage) {
  MipSettings settings;
  settings.model_name = "3DM-CV7-AHRS";
  MipFirmware ahrs(bench, settings);
  FirmwareHost ahrs_host(ahrs);
  const auto poll = [&](unsigned set, const std::string& fields_hex) {
    const auto answer = fields_of(ahrs_host.exchange(command(0x0C, fields_hex)));
    std::vector<Field> data;
    for (const Field& field : answer)
      if (field.set == set) data.push_back(field);
    return data;
  };
  ahrs_host.listen(seconds(2));
  bench->move(StageAxis::kX, Angle::degrees(90.0), ahrs_host.clock().now());
  ahrs_host.listen(seconds(1));
  // 20 deg/s about x, in rad/s; over a period of 1 ms.
  const auto moving = poll(0x80, "080D 80 00 03 05 06 07");
  ASSERT_EQ(moving.size(), 3U);
  EXPECT_FLOAT_EQ(as_float(moving[0].data, 0), 0.34906585F);
  EXPECT_EQ(as_float(moving[0].data, 1), 0.0F);
  EXPECT_FLOAT_EQ(as_float(moving[2].data, 0), 0.34906585e-3F);
  const auto rate = poll(0x82, "060D 82 00 01 0E");
  ASSERT_EQ(rate.size(), 1U);
  EXPECT_FLOAT_EQ(as_float(rate[0].data, 0), 0.34906585F);
  ahrs_host.listen(seconds(10));
  const auto still = poll(0x80, "070D 80 00 02 05 06");
  EXPECT_EQ(as_float(still.at(0).data, 0), 0.0F);
  // After a quarter of a turn about north, down is along -y of the body.
  EXPECT_FLOAT_EQ(as_float(still.at(1).data, 0), 0.25F);
  EXPECT_FLOAT_EQ(as_float(still.at(1).data, 1), -0.45F);
  EXPECT_NEAR(as_float(still.at(1).data, 2), 0.0F, 1e-7F);
  const auto attitude = poll(0x82, "080D 82 00 03 05 03 13");
  ASSERT_EQ(attitude.size(), 3U);
  // From z up (roll 180 degrees), a quarter of a turn on: -90 degrees.
  EXPECT_NEAR(as_float(attitude[0].data, 0), -1.5707963F, 1e-6F);
  EXPECT_NEAR(as_float(attitude[0].data, 2), 0.0F, 1e-6F);
  EXPECT_NEAR(as_float(attitude[1].data, 0), 0.70710678F, 1e-6F);
  EXPECT_NEAR(as_float(attitude[1].data, 1), -0.70710678F, 1e-6F);
  EXPECT_NEAR(as_float(attitude[2].data, 1), -9.80665F, 1e-5F);
}

TEST_F(MipFirmwareTest, TheGyroBiasIsSubtracted) {
  ASSERT_EQ(code(0x0C, "0F38 01 3F800000 00000000 00000000"), 0U);  // 1 rad/s
  const auto data = ask(0x0C, "060D 80 00 01 05");
  ASSERT_EQ(data.size(), 2U);
  EXPECT_EQ(as_float(data[1].data, 0), -1.0F);
}

TEST_F(MipFirmwareTest, WithoutPowerItForgetsWhatWasNotSaved) {
  EXPECT_EQ(code(0x0C, "0740 01 00070800"), 0U);  // 460800 Bd
  host.listen(milliseconds(10));
  EXPECT_EQ(firmware.line_speed(), 460800U);
  EXPECT_EQ(code(0x01, "0206"), 0U);
  EXPECT_NE(host.listen(seconds(1)), "");
  firmware.power(false, host.clock().now());
  EXPECT_EQ(host.listen(seconds(1)), "");
  firmware.power(true, host.clock().now());
  EXPECT_EQ(firmware.line_speed(), 115200U);
  EXPECT_EQ(host.listen(seconds(1)), "") << "idle, by its settings";
  EXPECT_EQ(code(0x01, "0206"), 0U);
  const auto data = fields_of(host.listen(milliseconds(15)));
  ASSERT_GE(data.size(), 2U);
  EXPECT_LT(big_endian(data[1].data, 0, 8), 1'100'000'000U) << "its time counts from power on";
}

class MipStreamingTest : public MipFirmwareTest {
 protected:
  MipStreamingTest() : MipFirmwareTest({.streaming_at_power_on = true}) {}
};

TEST_F(MipStreamingTest, StreamsAgainWhenPowerIsBack) {
  EXPECT_EQ(code(0x01, "0202"), 0U);
  EXPECT_EQ(host.listen(seconds(1)), "");
  firmware.power(false, host.clock().now());
  firmware.power(true, host.clock().now());
  EXPECT_EQ(fields_of(host.listen(seconds(1))).size(), 200U);
}

}  // namespace
}  // namespace abcal::sim
