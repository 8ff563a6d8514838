#include "sim/firmware/xsens_mti_firmware.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/xsens_mti/accelerometer.h"
#include "drivers/xsens_mti/codec.h"
#include "sim/firmware/firmware_stream.h"
#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;

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
  for (const char c : bytes) hex += fmt::format("{:02X}", static_cast<unsigned char>(c));
  return hex;
}

std::uint64_t big_endian(std::string_view data, std::size_t at, std::size_t count) {
  std::uint64_t value = 0;
  for (std::size_t n = 0; n < count; ++n) value = value << 8U | static_cast<unsigned char>(data.at(at + n));
  return value;
}

struct Message {
  unsigned id;
  std::string data;
};

/// Reads whole messages; anything else fails the test.
std::vector<Message> messages_of(const std::string& bytes) {
  std::vector<Message> messages;
  for (std::size_t at = 0; at < bytes.size();) {
    EXPECT_EQ(big_endian(bytes, at, 2), 0xFAFFU);
    std::size_t length = big_endian(bytes, at + 3, 1);
    std::size_t header = 4;
    if (length == 0xFF) {
      length = big_endian(bytes, at + 4, 2);
      header = 6;
      EXPECT_GT(length, 254U);
    }
    unsigned sum = 0;
    for (std::size_t n = at + 1; n <= at + header + length; ++n)
      sum += static_cast<unsigned char>(bytes.at(n));
    EXPECT_EQ(sum % 256, 0U);
    messages.push_back(
        {static_cast<unsigned>(big_endian(bytes, at + 2, 1)), bytes.substr(at + header, length)});
    at += header + length + 1;
  }
  return messages;
}

/// The items of a data message by their ids.
std::map<std::uint64_t, std::string> items_of(const Message& message) {
  EXPECT_EQ(message.id, 0x36U);
  std::map<std::uint64_t, std::string> items;
  for (std::size_t at = 0; at < message.data.size(); at += 3 + big_endian(message.data, at + 2, 1))
    items[big_endian(message.data, at, 2)] = message.data.substr(at + 3, big_endian(message.data, at + 2, 1));
  return items;
}

/// Number n of an item in one of the four formats, written after the manual and not after the driver.
double real_of(unsigned format, const std::string& data, std::size_t n) {
  switch (format) {
    case 0:
      return static_cast<double>(
          std::bit_cast<float>(static_cast<std::uint32_t>(big_endian(data, 4 * n, 4))));
    case 1:
      return static_cast<std::int32_t>(big_endian(data, 4 * n, 4)) / 1048576.0;
    case 2:
      return static_cast<std::int16_t>(big_endian(data, 6 * n + 4, 2)) +
             static_cast<double>(big_endian(data, 6 * n, 4)) / 4294967296.0;
    default:
      return std::bit_cast<double>(big_endian(data, 8 * n, 8));
  }
}

std::string command(unsigned id, const std::string& data_hex = {}) {
  const std::string data = from_hex(data_hex);
  std::string bytes = from_hex("FAFF");
  bytes.push_back(static_cast<char>(id));
  if (data.size() < 255) {
    bytes.push_back(static_cast<char>(data.size()));
  } else {
    bytes += from_hex(fmt::format("FF {:04X}", data.size()));
  }
  bytes += data;
  unsigned sum = 0;
  for (const char c : bytes.substr(1)) sum += static_cast<unsigned char>(c);
  bytes.push_back(static_cast<char>(256 - sum % 256));
  return bytes;
}

/// About 9.8 m/s2 per g_loc, not aligned.
BenchTruth good_truth() {
  BenchTruth truth;
  truth.sensitivity_matrix << 9.78, 0.11, -0.07, 0.05, 9.85, 0.13, -0.09, 0.02, 9.81;
  truth.offset = {0.12, -0.34, 0.05};
  return truth;
}

class XsensMtiFirmwareTest : public testing::Test {
 protected:
  explicit XsensMtiFirmwareTest(XsensMtiSettings settings = {}, BenchTruth truth = good_truth())
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  std::string raw(std::string_view hex) { return to_hex(host.exchange(from_hex(hex))); }
  /// The one answer to a command: "1D 4D5469..."
  std::string ask(unsigned id, const std::string& data_hex = {}) {
    const auto answers = messages_of(host.exchange(command(id, data_hex)));
    if (answers.size() != 1) return fmt::format("{} answers", answers.size());
    return fmt::format("{:02X} {}", answers[0].id, to_hex(answers[0].data));
  }
  void go_to_config() {
    host.send(command(0x30));
    host.listen(milliseconds(10));
  }
  /// The data messages of some time.
  std::vector<std::map<std::uint64_t, std::string>> data_of(Clock::Duration duration) {
    std::vector<std::map<std::uint64_t, std::string>> data;
    for (const Message& message : messages_of(host.listen(duration))) data.push_back(items_of(message));
    return data;
  }
  Clock::Instant now() { return host.clock().now(); }

  std::shared_ptr<SimBench> bench;
  XsensMtiFirmware firmware;
  FirmwareHost host;
};

TEST_F(XsensMtiFirmwareTest, TheFramesOfTheVendorsSoftwareGetItsAnswers) {
  host.listen(milliseconds(10));
  EXPECT_EQ(raw("FAFF3000D1"), "FAFF3100D0");
  EXPECT_EQ(raw("FAFF1800E9"), "FAFF190102E5");
  EXPECT_EQ(raw("FAFF180101E7"), "FAFF1900E8");  // 230400
  EXPECT_EQ(raw("FAFF1800E9"), "FAFF190101E6");
  EXPECT_EQ(raw("FAFF180102E6"), "FAFF1900E8");
  EXPECT_EQ(raw("FAFFC014 10200000 10600000 40200064 08100001 E0200000 B0").substr(0, 8), "FAFFC114");
  EXPECT_EQ(raw("FAFF1000F1"), "FAFF1100F0");
}

TEST_F(XsensMtiFirmwareTest, SaysWhatItIs) {
  go_to_config();
  EXPECT_EQ(ask(0x00), "01 037003F8");
  EXPECT_EQ(ask(0x02), "03 037003F8");
  EXPECT_EQ(ask(0x1C), "1D 4D54692D33302D32413847342020202020202020");  // "MTi-30-2A8G4" and blanks
  EXPECT_EQ(ask(0x1E), "1F 0105");
  EXPECT_EQ(ask(0x12), "13 0108020000003F00000000");
  const std::string block = ask(0x0C);
  EXPECT_EQ(block.size(), 3U + 2 * 118);
  EXPECT_EQ(ask(0x0C, "00FF"), block) << "as the maker's library asks after ReqEmts";
  EXPECT_THAT(block, StartsWith("0D 037003F8"));
  EXPECT_EQ(block.substr(3 + 2 * 98, 8), "037003F8");
  EXPECT_EQ(ask(0x62).size(), 3U + 2 * 3 * 22);
  EXPECT_EQ(ask(0x64), "65 0127");
  EXPECT_EQ(ask(0x64, "0029"), "65 ");
  EXPECT_EQ(ask(0x64), "65 0129");
  EXPECT_EQ(ask(0x48, "00000011 00000000"), "49 ");
  EXPECT_EQ(ask(0x48, "00000002 00000010"), "49 ");
  EXPECT_EQ(ask(0x48), "49 00000003");
  EXPECT_EQ(ask(0x84, "1234"), "85 ");
  EXPECT_EQ(ask(0x84), "85 1234");
  EXPECT_EQ(ask(0x2C), "2D ");
}

// Without 91 the maker's library ends with "Could not read device configuration".
TEST_F(XsensMtiFirmwareTest, AnswersWhatTheMakersRosDriverAsksBeforeItMeasures) {
  go_to_config();
  EXPECT_THAT(ask(0x90, "00FF"), StartsWith("91 "));
  const std::string block = from_hex(ask(0x0C).substr(3));
  ASSERT_EQ(block.size(), 118U);
  EXPECT_EQ(big_endian(block, 96, 2), 1U) << "devices";
  EXPECT_EQ(big_endian(block, 110, 2), 39U) << "filter profile";
  EXPECT_EQ(to_hex(block.substr(112, 3)), "010802") << "firmware";
  EXPECT_EQ(ask(0x10), "11 ");
  const auto answers = messages_of(host.exchange(command(0x22, "0006")));  // while it measures
  EXPECT_TRUE(std::any_of(answers.begin(), answers.end(), [](const Message& m) { return m.id == 0x23; }));
}

TEST_F(XsensMtiFirmwareTest, TakesTheOutputConfigurationOfTheRosDriver) {
  go_to_config();
  const std::string outputs =
      "1020FFFF1060FFFF1010FFFF4020006480200064C0200064081000642010006440300064E020FFFF";
  const std::string answer = ask(0xC0, outputs);
  EXPECT_EQ(answer, "C1 1020FFFF1060FFFF1010FFFF4020006480200064C0200064081000642010006440300064E020FFFF");
  EXPECT_EQ(ask(0xC0, "20200064 30100032 80400190"), "C1 202000643010003280400190");
  EXPECT_EQ(ask(0xC0, "50420064"), "42 21") << "no receiver";
  ask(0xC0, "20100064 20200064 30100064 E020FFFF");
  ask(0x10);
  const auto items = data_of(milliseconds(15)).back();
  // x points north, a quarter of a turn from east; the outputs are not aligned to better than 0.02.
  EXPECT_NEAR(real_of(0, items.at(0x2010), 0), std::sqrt(0.5), 0.02);
  EXPECT_NEAR(real_of(0, items.at(0x2010), 3), std::sqrt(0.5), 0.02);
  EXPECT_EQ(items.at(0x2020).size(), 36U);
  EXPECT_EQ(to_hex(items.at(0x3010)), "00018BCD");  // 101325 Pa
}

TEST_F(XsensMtiFirmwareTest, KeepsTheSettingsThatHostsReadAndWrite) {
  go_to_config();
  EXPECT_EQ(ask(0x04), "05 0480");
  EXPECT_EQ(ask(0x8E, "0000"), "8F ");
  EXPECT_EQ(ask(0xDA), "DB 0001");
  EXPECT_EQ(ask(0xDA, "0002"), "DB ");
  EXPECT_EQ(ask(0xDA), "DB 0002");
  EXPECT_EQ(ask(0xDA, "02"), "42 21");
  EXPECT_EQ(ask(0xDC), "DD 0000");
  EXPECT_EQ(ask(0x6E).size(), 3U + 48);
  EXPECT_EQ(ask(0x60).size(), 3U + 24);
  EXPECT_EQ(ask(0x76), "77 0000");
  EXPECT_EQ(ask(0x24), "25 01FF");
  EXPECT_EQ(ask(0xA4, "0000"), "A5 ");
  EXPECT_EQ(ask(0xEC, "00"), "ED 003F800000000000000000000000000000");
  EXPECT_EQ(ask(0xEC, "00 00000000 3F800000 00000000 00000000"), "ED ");
  EXPECT_EQ(ask(0xEC, "00"), "ED 00000000003F8000000000000000000000");
  EXPECT_EQ(ask(0xEC, "02"), "42 21");
}

TEST_F(XsensMtiFirmwareTest, WhatItDoesNotKnowIsNotedOnce) {
  go_to_config();
  EXPECT_EQ(ask(0x74, "00"), "42 04");
  EXPECT_EQ(ask(0x74, "00"), "42 04");
  ask(0xDA, "02");
  ASSERT_EQ(firmware.unserved().all().size(), 1U);
  EXPECT_EQ(firmware.unserved().all()[0].command, "message 74");
  EXPECT_EQ(firmware.unserved().all()[0].count, 2U);
}

TEST_F(XsensMtiFirmwareTest, ANewBaudRateHoldsFromTheNextResetOn) {
  go_to_config();
  ask(0x18, "80");
  EXPECT_EQ(firmware.line_speed(), 115200U);
  host.send(command(0x40));
  host.listen(seconds(1));
  EXPECT_EQ(firmware.line_speed(), 921600U);
}

TEST_F(XsensMtiFirmwareTest, ANewSessionStartsWithAnEmptyBuffer) {
  go_to_config();
  host.send(from_hex("FAFF0020"));
  firmware.session_starts();
  EXPECT_EQ(ask(0x00), "01 037003F8");
}

TEST(XsensMti680Test, HasTheOutputsOfItsReceiver) {
  XsensMtiSettings settings;
  settings.product_code = "MTi-680";
  settings.device_id = "0080000012345678";
  XsensMtiFirmware firmware(std::make_shared<SimBench>(BenchTruth{}), settings);
  FirmwareHost host(firmware);
  host.send(command(0x30));
  host.listen(milliseconds(10));
  const auto answers = messages_of(host.exchange(command(0xC0, "50420064 50220064 D0120064 70100004")));
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(to_hex(answers[0].data), "5042006450220064D012006470100004");
  const auto block = messages_of(host.exchange(command(0x0C)))[0].data;
  EXPECT_EQ(to_hex(block.substr(0, 8)), "1234567800800000");
  EXPECT_THAT(block.substr(32), StartsWith("MTi-680"));
}

TEST_F(XsensMtiFirmwareTest, AnswersErrorsWithTheirCodes) {
  go_to_config();
  EXPECT_EQ(ask(0x77), "42 04");
  EXPECT_EQ(ask(0x18, "33"), "42 20");
  EXPECT_EQ(ask(0x18, "0202"), "42 21");
  EXPECT_EQ(ask(0x00, "00"), "42 21");
  EXPECT_EQ(ask(0x30, "00"), "42 21");
  EXPECT_EQ(ask(0xC0, "402000"), "42 21") << "no whole entry";
  EXPECT_EQ(ask(0xC0, "77700064"), "42 21") << "no such data";
  EXPECT_EQ(ask(0xC0, "402C0064"), "42 21") << "no such frame";
  EXPECT_EQ(ask(0xC0, "10210064"), "42 21") << "a counter has no number format";
  std::string many;
  for (int n = 0; n < 33; ++n) many += "40200064";
  EXPECT_EQ(ask(0xC0, many), "42 21");
  EXPECT_EQ(ask(0x64, "0099"), "42 21");
  EXPECT_EQ(ask(0xC0), "C1 1020FFFF1060FFFF40200190E020FFFF") << "nothing of this has changed it";
}

TEST_F(XsensMtiFirmwareTest, IgnoresWhatIsDamagedAndFindsWhatFollows) {
  go_to_config();
  const std::string good = command(0x00);
  for (std::size_t at = 0; at < good.size(); ++at) {
    for (unsigned bit = 0; bit < 8; ++bit) {
      std::string bad = good;
      bad[at] = static_cast<char>(static_cast<unsigned char>(bad[at]) ^ (1U << bit));
      EXPECT_EQ(host.exchange(bad), "") << at << " " << bit;
      host.listen(milliseconds(200));  // Then a message that claims to be longer is given up.
    }
  }
  EXPECT_THAT(to_hex(host.exchange(from_hex("00 FA 37 FAFF") + good)), StartsWith("FAFF0104"));
  for (const char c : good.substr(0, 4)) EXPECT_EQ(host.exchange(std::string(1, c)), "");
  EXPECT_THAT(to_hex(host.exchange(good.substr(4))), StartsWith("FAFF0104"));
}

TEST_F(XsensMtiFirmwareTest, WakesUpAndMeasuresAfterHalfASecondUnlessItIsTakenOver) {
  EXPECT_EQ(to_hex(host.listen(milliseconds(499))), "FAFF3E00C3");
  EXPECT_EQ(data_of(milliseconds(51)).size(), 20U) << "at 400 Hz";
  go_to_config();
  EXPECT_EQ(host.listen(seconds(1)), "");
  EXPECT_EQ(ask(0x40), "41 ");
  EXPECT_EQ(host.exchange(command(0x30)), "") << "switched off meanwhile";
  EXPECT_EQ(to_hex(host.listen(milliseconds(310))), "FAFF3E00C3");
  EXPECT_EQ(host.exchange(command(0x3F)), "");
  EXPECT_EQ(host.listen(seconds(1)), "") << "in config";
  EXPECT_EQ(ask(0x00), "01 037003F8");
}

TEST_F(XsensMtiFirmwareTest, AnswersWhileItStreamsAndIsSilentInConfig) {
  host.listen(milliseconds(600));
  host.send(command(0x00));
  auto between = messages_of(host.listen(milliseconds(20)));
  const auto refused =
      std::find_if(between.begin(), between.end(), [](const Message& m) { return m.id == 0x42; });
  ASSERT_NE(refused, between.end());
  EXPECT_EQ(to_hex(refused->data), "04") << "not while it measures";
  EXPECT_EQ(between.size(), 9U);
  EXPECT_EQ(host.exchange(command(0x30)).size() % 41U, 5U) << "whole packets, and the answer";
  EXPECT_EQ(host.listen(seconds(2)), "");
}

class XsensSlowAnswerTest : public XsensMtiFirmwareTest {
 protected:
  XsensSlowAnswerTest()
      : XsensMtiFirmwareTest({.just_switched_on = false, .reply_delay = milliseconds(20)}) {}
};

TEST_F(XsensSlowAnswerTest, PacketsComeBetweenGotoConfigAndItsAnswer) {
  host.listen(milliseconds(99));
  host.send(command(0x30));
  const auto all = messages_of(host.listen(milliseconds(100)));
  ASSERT_EQ(all.size(), 9U);
  for (std::size_t n = 0; n + 1 < all.size(); ++n) EXPECT_EQ(all[n].id, 0x36U);
  EXPECT_EQ(all.back().id, 0x31U);
}

TEST_F(XsensMtiFirmwareTest, RatesAreThoseThatItCanMake) {
  go_to_config();
  EXPECT_EQ(ask(0xC0, "10200000 10600064 4020FFFF 08100001 E0200000"),
            "C1 1020FFFF1060FFFF402001900810"
            "0001"
            "E020FFFF");
  EXPECT_EQ(ask(0xC0), "C1 1020FFFF1060FFFF4020019008100001E020FFFF");
  for (const auto& [asked, made] : std::map<unsigned, unsigned>{{0, 400},
                                                                {401, 400},
                                                                {0xFFFE, 400},
                                                                {400, 400},
                                                                {399, 200},
                                                                {150, 100},
                                                                {100, 100},
                                                                {3, 2},
                                                                {1, 1}})
    EXPECT_EQ(ask(0xC0, fmt::format("4020{:04X}", asked)), fmt::format("C1 4020{:04X}", made));
}

TEST_F(XsensMtiFirmwareTest, EveryOutputHasItsRate) {
  go_to_config();
  ask(0xC0, "1020FFFF 1060FFFF 40200064 08100001 E0200000 C0200032");
  ask(0x10);
  const Clock::Instant start = now();
  const auto data = data_of(seconds(4));
  ASSERT_EQ(data.size(), 400U);
  std::map<std::uint64_t, int> count;
  std::uint64_t time = 0;
  for (std::size_t n = 0; n < data.size(); ++n) {
    for (const auto& [id, bytes] : data[n]) ++count[id];
    EXPECT_EQ(big_endian(data[n].at(0x1020), 0, 2), n);
    const std::uint64_t sampled = big_endian(data[n].at(0x1060), 0, 4);
    if (n > 0) {
      EXPECT_EQ(sampled - time, 100U);  // in 0.1 ms
    }
    time = sampled;
  }
  EXPECT_EQ(time / 10, static_cast<std::uint64_t>((now() - bench->start()) / milliseconds(1)) / 10 * 10);
  EXPECT_LE(now() - start, seconds(4));
  EXPECT_EQ(count,
            (std::map<std::uint64_t, int>{
                {0x1020, 400}, {0x1060, 400}, {0x4020, 400}, {0x0810, 4}, {0xE020, 400}, {0xC020, 200}}));
}

TEST_F(XsensMtiFirmwareTest, ThePacketCounterWraps) {
  go_to_config();
  ask(0xC0, "1020FFFF 40200190");
  ask(0x10);
  const auto data = data_of(seconds(170));  // 68000 packets
  ASSERT_GT(data.size(), 65537U);
  EXPECT_EQ(to_hex(data[65535].at(0x1020)), "FFFF");
  EXPECT_EQ(to_hex(data[65536].at(0x1020)), "0000");
}

TEST_F(XsensMtiFirmwareTest, AllFourNumberFormatsHoldTheWorldsOutput) {
  bench->move(StageAxis::kX, Angle::degrees(37), now());
  host.listen(seconds(10));
  go_to_config();
  ask(0xC0, "40200064 40210064 40220064 40230064 08110064 08120064 08130064 40260064");
  ask(0x10);
  const auto data = data_of(milliseconds(15));
  ASSERT_GE(data.size(), 1U);
  const Eigen::Vector3d truth = bench->output(now(), 0).value;
  ASSERT_LT(truth[1] * truth[2], 90.0);
  const std::array<std::size_t, 4> sizes{12, 12, 18, 24};
  const std::array<double, 4> steps{1e-6, std::ldexp(0.5, -20), std::ldexp(0.5, -32), 0.0};
  for (unsigned format = 0; format < 4; ++format) {
    const std::string& item = data[0].at(0x4020U + format);
    ASSERT_EQ(item.size(), sizes[format]);
    const auto by_the_driver =
        xbus::decode_acceleration({static_cast<std::uint16_t>(0x4020U + format), item});
    ASSERT_TRUE(by_the_driver.has_value());
    for (std::size_t j = 0; j < 3; ++j) {
      const auto at = static_cast<Eigen::Index>(j);
      EXPECT_NEAR(real_of(format, item, j), truth[at], steps[format]) << format << " " << j;
      EXPECT_EQ((*by_the_driver)[at], real_of(format, item, j));
    }
    if (format > 0) {
      EXPECT_EQ(real_of(format, data[0].at(0x0810U + format), 0), 23.0);
    }
  }
  EXPECT_EQ(data[0].at(0x4026), data[0].at(0x4022)) << "the frame changes nothing of it";
}

class XsensNegativeTest : public XsensMtiFirmwareTest {
 protected:
  static BenchTruth truth() {
    BenchTruth truth;
    truth.sensitivity_matrix.setZero();
    truth.offset = {-7.263571, -4000.0, 0.046186};  // u as in a capture; v beyond FP12.20
    return truth;
  }
  XsensNegativeTest() : XsensMtiFirmwareTest({}, truth()) {}
};

TEST_F(XsensNegativeTest, FixedPointsAreTwosComplementsAndSaturate) {
  go_to_config();
  ask(0xC0, "40210064 40220064");
  ask(0x10);
  const auto data = data_of(milliseconds(15));
  ASSERT_GE(data.size(), 1U);
  const std::string& fp1220 = data[0].at(0x4021);
  EXPECT_EQ(to_hex(fp1220).substr(8, 8), "80000000");
  EXPECT_NEAR(real_of(1, fp1220, 0), -7.263571, 1e-6);
  const std::string& fp1632 = data[0].at(0x4022);
  EXPECT_EQ(to_hex(fp1632).substr(8, 4), "FFF8");  // -8 and a fraction, as the capture has it
  EXPECT_NEAR(real_of(2, fp1632, 0), -7.263571, 1e-9);
  EXPECT_EQ(real_of(2, fp1632, 1), -4000.0);
  EXPECT_NEAR(real_of(2, fp1632, 2), 0.046186, 1e-9);
}

TEST_F(XsensMtiFirmwareTest, LongDataHaveTheExtendedLength) {
  go_to_config();
  ask(0xC0,
      "1010FFFF 1020FFFF 1060FFFF 08130064 20330064 40130064 40230064 40330064 40430064 80230064 80330064 "
      "C0230064 E010FFFF E020FFFF");
  ask(0x10);
  const std::string bytes = host.listen(milliseconds(12));
  EXPECT_THAT(to_hex(bytes), StartsWith("FAFF36FF01"));
  const auto all = messages_of(bytes);
  ASSERT_EQ(all.size(), 1U);
  const auto items = items_of(all[0]);
  EXPECT_EQ(items.size(), 14U);
  EXPECT_EQ(real_of(3, items.at(0x4043), 2), real_of(3, items.at(0x4023), 2));
  EXPECT_EQ(real_of(3, items.at(0x4013), 2), real_of(3, items.at(0x4023), 2) * 0.01);
  EXPECT_EQ(items.at(0x1010).size(), 12U);
  EXPECT_EQ(big_endian(items.at(0x1010), 4, 2), 2000U);
  EXPECT_EQ(to_hex(items.at(0xE010)), "03");
  xbus::MessageParser parser;
  parser.feed(bytes);
  const auto message = parser.next();
  ASSERT_TRUE(message.has_value()) << "the driver's parser takes it too";
  EXPECT_EQ(message->data.size(), all[0].data.size());
}

class XsensClippingTest : public XsensMtiFirmwareTest {
 protected:
  static BenchTruth truth() {
    BenchTruth truth = good_truth();
    truth.full_scale = 9.0;
    return truth;
  }
  XsensClippingTest() : XsensMtiFirmwareTest({}, truth()) {}
};

TEST_F(XsensClippingTest, TheStatusWordSaysWhichAxisClips) {
  go_to_config();
  ask(0x10);
  auto data = data_of(milliseconds(10));
  ASSERT_FALSE(data.empty());
  EXPECT_EQ(to_hex(data.back().at(0xE020)), "00080403");  // z, and that something clips
  EXPECT_EQ(real_of(0, data.back().at(0x4020), 2), 9.0);
  bench->move(StageAxis::kX, Angle::degrees(45), now());
  data = data_of(seconds(10));
  EXPECT_EQ(to_hex(data.back().at(0xE020)), "00000003");
}

TEST_F(XsensMtiFirmwareTest, AFaultyWorldMakesNoReadings) {
  host.listen(seconds(1));
  bench->inject({.kind = FaultKind::kNoOutput, .at = now(), .until = now() + seconds(1)});
  EXPECT_EQ(host.listen(milliseconds(999)), "");
  EXPECT_EQ(data_of(seconds(1)).size(), 400U);
  bench->inject({.kind = FaultKind::kNotFinite, .at = now()});
  EXPECT_TRUE(std::isnan(real_of(0, data_of(milliseconds(10)).back().at(0x4020), 0)));
}

TEST(XsensMtiSettingsTest, RefusesWhatCannotBe) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  for (const char* id : {"", "037003F", "037003G8", "037003F8 ", "0x3703F8"})
    EXPECT_THROW(XsensMtiFirmware(bench, {.device_id = id}), std::invalid_argument) << id;
  EXPECT_NO_THROW(XsensMtiFirmware(bench, {.device_id = "00000000037003F8"}));
  EXPECT_THROW(XsensMtiFirmware(bench, {.product_code = std::string(21, 'M')}), std::invalid_argument);
  EXPECT_THROW(XsensMtiFirmware(bench, {.baud = 12345}), std::invalid_argument);
  EXPECT_THROW(XsensMtiFirmware(bench, {.base_rate_hz = 0}), std::invalid_argument);
}

// End to end with the driver, which was written independently.

class XsensDriverTest : public testing::Test {
 protected:
  void begin(BenchTruth truth, double rate_hz = 100.0, XsensMtiSettings settings = {}) {
    bench = std::make_shared<SimBench>(std::move(truth), clock.now());
    AccelerometerSettings wanted;
    wanted.rate_hz = rate_hz;
    driver = std::make_unique<XsensMtiAccelerometer>(
        std::make_unique<FirmwareStream>(std::make_shared<XsensMtiFirmware>(bench, settings), clock), clock,
        wanted);
  }

  SimClock clock;
  std::shared_ptr<SimBench> bench;
  std::unique_ptr<Accelerometer> driver;
};

TEST_F(XsensDriverTest, SaysWhatItIsAlsoWhileItStreams) {
  for (const bool just_switched_on : {true, false}) {
    begin(good_truth(), 100.0, {.just_switched_on = just_switched_on});
    clock.sleep_until(clock.now() + seconds(1));
    const AccelerometerInfo info = driver->identify();
    EXPECT_EQ(info.model, "MTi-30-2A8G4");
    EXPECT_EQ(info.serial_number, "037003F8");
    EXPECT_EQ(info.firmware, "1.8.2");
    EXPECT_EQ(info.output_unit, "m/s2");
  }
}

TEST_F(XsensDriverTest, TheMeanOfItsReadingsIsTheTruthWithinTheNoise) {
  constexpr int kReadings = 10000;
  BenchTruth truth = good_truth();
  truth.noise = 0.02;
  begin(truth);
  bench->move(StageAxis::kX, Angle::degrees(-72), clock.now());
  clock.sleep_until(clock.now() + seconds(20));
  driver->start();
  EXPECT_EQ(driver->identify().rate_hz, 100.0);
  driver->start();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Clock::Instant last = clock.now();
  for (int n = 0; n < kReadings; ++n) {
    const auto reading = driver->next(clock.now() + seconds(1));
    ASSERT_TRUE(reading.has_value());
    EXPECT_EQ(reading->sequence, static_cast<std::uint64_t>(n));
    EXPECT_FALSE(reading->over_range);
    if (n > 0) {
      EXPECT_EQ(reading->arrival - last, milliseconds(10));
    }
    if (n > 100) {
      EXPECT_EQ(reading->temperature_degc, 23.0);
    }
    last = reading->arrival;
    sum += reading->output;
  }
  const Eigen::Vector3d expected =
      truth.sensitivity_matrix * bench->specific_force(clock.now()) + truth.offset;
  for (int j = 0; j < 3; ++j)
    EXPECT_NEAR(sum[j] / kReadings, expected[j], 4.0 * truth.noise / std::sqrt(kReadings));
  const StreamHealth health = driver->health();
  EXPECT_EQ(health.readings, static_cast<std::uint64_t>(kReadings));
  EXPECT_EQ(health.lost_readings + health.bad_frames + health.skipped_bytes, 0U);
  driver->stop();
  clock.sleep_until(clock.now() + seconds(5));
  EXPECT_THROW(driver->next(clock.now() + seconds(1)), InstrumentError);
}

TEST_F(XsensDriverTest, ClippingIsToldAndTheFastestRateIsWhole) {
  BenchTruth truth = good_truth();
  truth.full_scale = 9.0;
  begin(truth, 400.0);
  driver->start();
  for (int n = 0; n < 4000; ++n) {
    const auto reading = driver->next(clock.now() + seconds(1));
    ASSERT_TRUE(reading.has_value());
    EXPECT_TRUE(reading->over_range);
    EXPECT_EQ(reading->output[2], 9.0);
    EXPECT_EQ(reading->sequence, static_cast<std::uint64_t>(n));
  }
}

TEST_F(XsensDriverTest, ARateThatItDoesNotMakeIsRefused) {
  begin(good_truth(), 150.0);
  try {
    driver->start();
    ADD_FAILURE() << "nothing was thrown";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kRefused);
    EXPECT_THAT(error.what(), HasSubstr("it set its acceleration output to 100"));
  }
}

TEST(XsensMtiMotionTest, GyroMagnetometerAndAttitudeFollowTheStage) {
  BenchTruth truth;
  truth.sensitivity_matrix *= 9.8;
  const auto bench = std::make_shared<SimBench>(truth);
  XsensMtiFirmware firmware(bench);
  FirmwareHost host(firmware);
  host.listen(milliseconds(10));
  host.exchange(command(0x30));
  // Euler in all three frames, rate of turn, delta quaternion, magnetic field, rotation matrix, quaternion.
  host.exchange(command(0xC0, "2030000A 2034000A 2038000A 8020000A 8030000A C020000A 2020000A 2010000A"));
  host.exchange(command(0x10));
  const auto last_of = [&](Clock::Duration duration) {
    const auto messages = messages_of(host.listen(duration));
    return items_of(messages.back());
  };
  const auto value = [](const std::map<std::uint64_t, std::string>& items, std::uint64_t id, std::size_t n) {
    return real_of(0, items.at(id), n);
  };
  auto items = last_of(seconds(1));
  EXPECT_NEAR(value(items, 0x2030, 2), 90.0, 1e-5) << "x points north, from east";
  EXPECT_NEAR(value(items, 0x2034, 0), 180.0, 1e-5) << "z is up, from down";
  EXPECT_NEAR(value(items, 0x2038, 2), 0.0, 1e-5);
  bench->move(StageAxis::kX, Angle::degrees(90.0), host.clock().now());
  items = last_of(seconds(1));
  EXPECT_NEAR(value(items, 0x8020, 0), 0.34906585, 1e-7);
  EXPECT_NEAR(value(items, 0x8030, 1), std::sin(0.5 * 0.034906585), 1e-7) << "a tenth of a second";
  items = last_of(seconds(10));
  EXPECT_EQ(value(items, 0x8020, 0), 0.0);
  EXPECT_EQ(value(items, 0x8030, 0), 1.0);
  EXPECT_NEAR(value(items, 0x2038, 0), 90.0, 1e-4);
  EXPECT_NEAR(value(items, 0xC020, 0), 0.25 / std::hypot(0.25, 0.45), 1e-6);
  EXPECT_NEAR(value(items, 0xC020, 1), -0.45 / std::hypot(0.25, 0.45), 1e-6);
  // y of the body is up: second column of the matrix.
  EXPECT_NEAR(value(items, 0x2020, 5), 1.0, 1e-6);
  const Eigen::Quaterniond q(value(items, 0x2010, 0), value(items, 0x2010, 1), value(items, 0x2010, 2),
                             value(items, 0x2010, 3));
  EXPECT_TRUE((q * Eigen::Vector3d::UnitY()).isApprox(Eigen::Vector3d::UnitZ(), 1e-6));
}

TEST_F(XsensMtiFirmwareTest, WithoutPowerItIsSilentAndWakesUpThen) {
  go_to_config();
  host.exchange(command(0x10));
  EXPECT_FALSE(data_of(seconds(1)).empty());
  firmware.power(false, now());
  EXPECT_EQ(host.listen(seconds(1)), "");
  EXPECT_EQ(host.exchange(command(0x30)), "");
  firmware.power(true, now());
  const auto messages = messages_of(host.listen(seconds(1)));
  ASSERT_GT(messages.size(), 10U);
  EXPECT_EQ(messages.front().id, 0x3EU) << "WakeUp";
  EXPECT_EQ(messages[1].id, 0x36U) << "then it measures";
}

}  // namespace
}  // namespace abcal::sim
