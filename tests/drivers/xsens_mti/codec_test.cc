#include "drivers/xsens_mti/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/drivers/xsens_mti/reference_decoder.h"
#include "tests/support/test_data.h"

namespace abcal::xbus {
namespace {

namespace reference = test::xbus_reference;

std::string from_hex(std::string_view hex) {
  std::string bytes;
  std::string digits;
  for (const char c : hex) {
    if (c == ' ') continue;
    digits += c;
    if (digits.size() < 2) continue;
    bytes += static_cast<char>(std::stoi(digits, nullptr, 16));
    digits.clear();
  }
  return bytes;
}

struct Found {
  unsigned id;
  std::string data;
  bool operator==(const Found&) const = default;
};

std::vector<Found> parse(std::string_view bytes, std::size_t piece = 1) {
  MessageParser parser;
  std::vector<Found> found;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto message = parser.next()) found.push_back({message->id, std::string(message->data)});
  }
  return found;
}

std::optional<Eigen::Vector3d> acceleration_of(const Found& found) {
  for (const Item& item : split_items(found.data).value_or(std::vector<Item>()))
    if (kind_of(item.id) == kAcceleration) return decode_acceleration(item);
  return std::nullopt;
}

const std::string kCapture1 = from_hex(
    "fa ff 36 62 102002a986 1060040314ed53 10100c07440be007e301140d2f1837 e0200401800007 "
    "40200cbc8e5466c0e82f10bf9ad29e "
    "40100cb935269fbd949930bc462346 80200cbb425c343b1068df3ae1c7e5 8030103f800001b778c7f03738d82737107fee "
    "f7");

TEST(XbusCodecTest, WritesTheFramesOfTheVendorsAndOtherPrograms) {
  EXPECT_EQ(make_message(kGotoConfig), from_hex("FA FF 30 00 D1"));
  EXPECT_EQ(make_message(0x31), from_hex("FA FF 31 00 D0"));
  EXPECT_EQ(make_message(kGotoMeasurement), from_hex("FA FF 10 00 F1"));
  EXPECT_EQ(make_message(0x18), from_hex("FA FF 18 00 E9"));
  EXPECT_EQ(make_message(0x18, "\x02"), from_hex("FA FF 18 01 02 E6"));
  EXPECT_EQ(make_message(0x18, "\x01"), from_hex("FA FF 18 01 01 E7"));
  EXPECT_EQ(make_message(kSetOutputConfiguration, output_configuration({{kPacketCounter, 0},
                                                                        {kSampleTimeFine, 0},
                                                                        {kAcceleration, 100},
                                                                        {kTemperature, 1},
                                                                        {kStatusWord, 0}})),
            from_hex("fa ff c0 14 10200000 10600000 40200064 08100001 e0200000 b0"));
}

TEST(XbusCodecTest, ReadsTheAnswerToTheOutputConfiguration) {
  const auto found = parse(from_hex("fa ff c1 14 10200000 10600000 40200064 08100001 e0200000 af"));
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found[0].id, 0xC1U);
  const auto outputs = decode_output_configuration(found[0].data);
  ASSERT_TRUE(outputs);
  ASSERT_EQ(outputs->size(), 5U);
  EXPECT_EQ((*outputs)[2].id, kAcceleration);
  EXPECT_EQ((*outputs)[2].rate_hz, 100);
  EXPECT_FALSE(decode_output_configuration("abc"));
}

TEST(XbusCodecTest, DecodesTheFirstMessageOfTheCapture) {
  for (const std::size_t piece : {std::size_t{1}, std::size_t{10}, kCapture1.size()}) {
    const auto found = parse(kCapture1, piece);
    ASSERT_EQ(found.size(), 1U);
    EXPECT_EQ(found[0].id, kMtData2);
    const auto items = split_items(found[0].data);
    ASSERT_TRUE(items);
    EXPECT_EQ((*items)[0].id, kPacketCounter);
    EXPECT_EQ(decode_u16((*items)[0].data), 43398);
    EXPECT_EQ(decode_u32((*items)[1].data), 51703123U);
    const auto acceleration = acceleration_of(found[0]);
    ASSERT_TRUE(acceleration);
    EXPECT_NEAR(acceleration->x(), -0.017374,
                5e-7);  // half of the last digit printed in docs/protocols/xbus.md
    EXPECT_NEAR(acceleration->y(), -7.255745, 5e-7);
    EXPECT_NEAR(acceleration->z(), -1.209553, 5e-7);
  }
}

TEST(XbusCodecTest, DecodesAllFourNumberFormats) {
  const std::string fp1632 = from_hex("0bd2d9600000 bc86a000fff8 c82ab000fffe");
  const auto capture3 = decode_acceleration({0x4022, fp1632});
  ASSERT_TRUE(capture3);
  EXPECT_NEAR(capture3->x(), 0.046186, 5e-7);
  EXPECT_NEAR(capture3->y(), -7.263571, 5e-7);
  EXPECT_NEAR(capture3->z(), -1.218099, 5e-7);

  const auto mti300 = decode_acceleration({0x4020, from_hex("BD A2 1A F8 BE 2A 8E 96 41 1D 27 A2")});
  ASSERT_TRUE(mti300);
  EXPECT_NEAR(mti300->x(), -0.0791530, 5e-8);
  EXPECT_NEAR(mti300->y(), -0.1665596, 1e-7);  // printed from -0.16655955, itself rounded
  EXPECT_NEAR(mti300->z(), 9.8221760, 5e-7);   // printed with one digit more than a float32 has

  // 1.5, -2.25 and 9.8125 are exact in every format.
  const Eigen::Vector3d expected(1.5, -2.25, 9.8125);
  EXPECT_EQ(decode_acceleration({0x4021, from_hex("00180000 FFDC0000 009D0000")}), expected);
  EXPECT_EQ(decode_acceleration({0x4022, from_hex("800000000001 C0000000FFFD D00000000009")}), expected);
  EXPECT_EQ(decode_acceleration({0x4023, from_hex("3FF8000000000000 C002000000000000 4023A00000000000")}),
            expected);
  EXPECT_EQ(decode_acceleration({0x402F, from_hex("3FF8000000000000 C002000000000000 4023A00000000000")}),
            expected)
      << "the frame is of no account";
}

TEST(XbusCodecTest, DecodesTheTemperature) {
  EXPECT_EQ(decode_temperature({0x0810, from_hex("42 16 80 00")}), 37.625);
  EXPECT_EQ(decode_temperature({0x0811, from_hex("FFF00000")}), -1.0);
  EXPECT_FALSE(decode_temperature({0x0810, from_hex("42 16 80")}));
  EXPECT_FALSE(decode_temperature({0x0813, from_hex("42 16 80 00")}));
}

TEST(XbusCodecTest, DecodesNumbersOnlyAtTheirOwnLength) {
  const std::string bytes(64, '\x01');
  constexpr std::size_t kBytes[] = {12, 12, 18, 24};
  for (std::size_t size = 0; size <= bytes.size(); ++size) {
    const std::string_view data = std::string_view(bytes).substr(0, size);
    for (unsigned format = 0; format < 4; ++format) {
      const auto id = static_cast<std::uint16_t>(0x4020U + format);
      EXPECT_EQ(decode_acceleration({id, data}).has_value(), size == kBytes[format]);
    }
    EXPECT_EQ(decode_u16(data).has_value(), size == 2);
    EXPECT_EQ(decode_u32(data).has_value(), size == 4);
  }
}

TEST(XbusCodecTest, WritesAndReadsTheExtendedLength) {
  for (const std::size_t size : {std::size_t{254}, std::size_t{255}, std::size_t{256}, kMaxData}) {
    const std::string data(size, 'x');
    const std::string message = make_message(0x0D, data);
    EXPECT_EQ(message, reference::message(0x0D, data));
    EXPECT_EQ(message.size(), size + (size < 255 ? 5 : 7));
    for (const std::size_t piece : {std::size_t{1}, message.size()}) {
      const auto found = parse(message, piece);
      ASSERT_EQ(found.size(), 1U);
      EXPECT_EQ(found[0].data, data);
    }
  }
  EXPECT_THROW(make_message(0x0D, std::string(kMaxData + 1, 'x')), std::invalid_argument);
}

TEST(XbusCodecTest, TellsTheClippingOfTheAccelerometer) {
  EXPECT_FALSE(accelerometer_clipped(0x0000'0007));
  for (const std::uint32_t bit : {8U, 9U, 10U})
    EXPECT_TRUE(accelerometer_clipped(1U << bit | 1U << 19U)) << bit;
  for (const std::uint32_t bit : {11U, 12U, 13U, 14U, 15U, 16U})
    EXPECT_FALSE(accelerometer_clipped(1U << bit | 1U << 19U)) << bit;
  EXPECT_TRUE(accelerometer_clipped(1U << 19U)) << "something clipped, and nothing else says what";
  EXPECT_FALSE(accelerometer_clipped(0x0180'0007U)) << "of the capture";
}

TEST(XbusCodecTest, RefusesItemsThatDoNotFillTheMessage) {
  EXPECT_TRUE(split_items(""));
  EXPECT_TRUE(split_items(from_hex("102002A986")));
  EXPECT_FALSE(split_items(from_hex("102002A9")));
  EXPECT_FALSE(split_items(from_hex("1020")));
  EXPECT_FALSE(split_items(from_hex("102002A98640")));
  EXPECT_TRUE(parse(reference::message(0x36, from_hex("102002A9"))).empty());
  EXPECT_EQ(parse(reference::message(0x37, from_hex("102002A9"))).size(), 1U) << "others have no items";
}

TEST(XbusCodecTest, RejectsEverySingleDamagedByteOfAMessage) {
  const std::string good = reference::data_message(7, 1.0F, 2.0F, 3.0F);
  const std::string filler(300, '\0');  // A damaged length claims bytes: let them come.
  for (const std::string& message : {kCapture1, reference::data_message(6, 0.25F, -9.8F, 0.125F)}) {
    const auto undamaged = parse(message + good + filler, 1000);
    ASSERT_EQ(undamaged.size(), 2U);
    for (std::size_t at = 0; at < message.size(); ++at) {
      for (unsigned change = 1; change < 256; ++change) {
        std::string damaged = message;
        damaged[at] = static_cast<char>(static_cast<unsigned char>(damaged[at]) ^ change);
        const auto found = parse(damaged + good + filler + std::string(2048, '\0'), 5000);
        ASSERT_EQ(found.size(), 1U) << "byte " << at << " changed by " << change;
        ASSERT_EQ(found.front(), undamaged.back());
      }
    }
  }
}

TEST(XbusCodecTest, FindsMessagesInGarbageByteByByte) {
  const std::string garbage = from_hex("FA FA FF 36 05 10 20 02 00 00 00 FF FA FF 36");
  const std::string bytes =
      garbage + kCapture1 + garbage + make_message(0x31) + garbage + kCapture1 + std::string(300, '\0');
  const auto expected = reference::decode(bytes);
  ASSERT_EQ(expected.messages.size(), 3U);
  for (std::size_t piece = 1; piece < 40; ++piece) {
    const auto found = parse(bytes, piece);
    ASSERT_EQ(found.size(), 3U) << piece;
    EXPECT_EQ(found[0].data, found[2].data);
  }
}

TEST(XbusCodecTest, FindsAMessageBehindAFalseBeginningOnceTheLineIsSilent) {
  MessageParser parser;
  parser.feed(from_hex("FA FF 36 F0") + make_message(0x31));
  EXPECT_FALSE(parser.next());
  EXPECT_TRUE(parser.has_partial());
  const auto message = parser.next_behind_partial();
  ASSERT_TRUE(message);
  EXPECT_EQ(message->id, 0x31);
  EXPECT_EQ(parser.skipped_bytes(), 4U);
  EXPECT_FALSE(parser.has_partial());
}

TEST(XbusCodecTest, SaysErrorsInWords) {
  EXPECT_EQ(error_in_words(0x04), "message not valid or not supported");
  EXPECT_EQ(error_in_words(30), "timer overflow");
  EXPECT_EQ(error_in_words(32), "baud rate not valid");
  EXPECT_EQ(error_in_words(0x21), "parameter not valid");
  EXPECT_EQ(error_in_words(41), "more data than the link carries");
  EXPECT_EQ(error_in_words(0x99), "no meaning known");
}

/// The accelerations of a capture's decoded text, in order.
std::vector<Eigen::Vector3d> expected_accelerations(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::vector<Eigen::Vector3d> accelerations;
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("Acceleration(")) continue;
    Eigen::Vector3d acceleration;
    for (int i = 0; i < 3; ++i) {
      std::getline(file, line);
      acceleration(i) = std::stod(line.substr(line.find(':') + 1));
    }
    accelerations.push_back(acceleration);
  }
  return accelerations;
}

void expect_capture(const std::string& stem) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "wire/" + stem + ".bin");
  const auto decoded = test::shared_data("wire/" + stem + ".decoded.txt");
  ASSERT_TRUE(decoded);
  std::ifstream file(path, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(file), {}};
  const std::vector<Eigen::Vector3d> expected = expected_accelerations(*decoded);
  ASSERT_EQ(expected.size(), 96U);  // From the README of the shared data.
  for (const std::size_t piece : {std::size_t{1}, std::size_t{100}, bytes.size()}) {
    const auto found = parse(bytes, piece);
    ASSERT_EQ(found.size(), 100U);
    std::size_t n = 0;
    for (const Found& each : found) {
      if (const auto acceleration = acceleration_of(each)) {
        ASSERT_LT(n, expected.size());
        EXPECT_EQ(*acceleration, expected[n]) << n;  // The text has all digits.
        ++n;
      }
    }
    EXPECT_EQ(n, expected.size());
  }
}

TEST(XbusCodecTest, DecodesTheCaptureInFloat32) {
  expect_capture("xsens_float32");
}

TEST(XbusCodecTest, DecodesTheCaptureInFixedPoint) {
  expect_capture("xsens_fp1632");
}

}  // namespace
}  // namespace abcal::xbus
