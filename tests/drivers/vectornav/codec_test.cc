#include "drivers/vectornav/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include "tests/drivers/vectornav/reference_decoder.h"
#include "tests/support/test_data.h"

namespace abcal::vectornav {
namespace {

namespace reference = test::vectornav_reference;
using ::testing::ElementsAre;

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

/// Messages that the parser finds if the bytes come in pieces of this size: texts, and binary payloads.
std::vector<std::string> parse(std::string_view bytes, std::size_t piece = 1, std::string only_header = {}) {
  MessageParser parser(std::move(only_header));
  std::vector<std::string> found;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    parser.feed(bytes.substr(at, piece));
    while (const auto message = parser.next()) {
      const auto* text = std::get_if<TextMessage>(&*message);
      found.emplace_back(text != nullptr ? text->text : std::get<BinaryMessage>(*message).payload);
    }
  }
  return found;
}

constexpr std::string_view kRecorded =
    "$VNYMR,-165.970,-037.299,+001.252,+00.2894,+00.0706,+00.7482,-05.961,-00.184,-07.853,+00.000885,"
    "-00.000192,-00.000642*69\r\n";
const std::string kManualExample = from_hex("FA 01 08 00 93 50 2E 42 83 3E F1 3F 48 B5 04 BB 92 88");

TEST(VectorNavCodecTest, WritesTheFramesOfTheVendorsLibrary) {
  EXPECT_EQ(make_message("VNRRG,01", Checksum::kCrc16), "$VNRRG,01*E15F\r\n");
  EXPECT_EQ(make_message("VNWRG,06,1,1", Checksum::kCrc16), "$VNWRG,06,1,1*CA15\r\n");
  EXPECT_EQ(make_message("VNWRG,07,2,1", Checksum::kCrc16), "$VNWRG,07,2,1*3914\r\n");
  EXPECT_EQ(make_message("VNWRG,75,3,400,01,0321", Checksum::kCrc16), "$VNWRG,75,3,400,01,0321*D84E\r\n");
}

TEST(VectorNavCodecTest, WritesTheFramesWithTheShortChecksum) {
  EXPECT_EQ(make_message("VNRRG,01", Checksum::kXor8), "$VNRRG,01*72\r\n");
  EXPECT_EQ(make_message("VNRRG,54", Checksum::kXor8), "$VNRRG,54*72\r\n");
  EXPECT_EQ(make_message("VNWRG,06,0", Checksum::kXor8), "$VNWRG,06,0*6C\r\n");
  EXPECT_EQ(make_message("VNWRG,07,40", Checksum::kXor8), "$VNWRG,07,40*59\r\n");
  EXPECT_EQ(make_message("VNASY,0", Checksum::kXor8), "$VNASY,0*4F\r\n");
}

TEST(VectorNavCodecTest, TheCrcOverAMessageAndItsCrcIsZero) {
  EXPECT_EQ(crc16(std::string_view(kManualExample).substr(1)), 0);
  for (const std::string_view text : {"", "V", "VNRRG,01", "a longer text with all sorts of things in it"})
    EXPECT_EQ(crc16(text), reference::crc(text)) << text;
}

TEST(VectorNavCodecTest, DecodesTheRecordedLine) {
  for (const std::size_t piece : {std::size_t{1}, std::size_t{7}, kRecorded.size()}) {
    const auto texts = parse(kRecorded, piece);
    ASSERT_EQ(texts.size(), 1U);
    const auto measurement = decode_text_measurement(texts.front());
    ASSERT_TRUE(measurement);
    EXPECT_EQ(measurement->acceleration_mps2, Eigen::Vector3d(-5.961, -0.184, -7.853));
    EXPECT_NEAR(measurement->acceleration_mps2.norm(), 9.861,
                5e-4);  // half of the last digit of docs/protocols/vectornav.md
    EXPECT_FALSE(measurement->temperature_degc);
    EXPECT_FALSE(measurement->time_startup_ns);
  }
}

TEST(VectorNavCodecTest, DecodesTheBinaryExampleOfTheManual) {
  MessageParser parser;
  parser.feed(kManualExample);
  const auto message = parser.next();
  ASSERT_TRUE(message);
  const auto& binary = std::get<BinaryMessage>(*message);
  const auto ypr = field(binary, kCommon, 3);
  ASSERT_TRUE(ypr);
  ASSERT_EQ(ypr->size(), 12U);
  const auto value = [&](std::size_t at) {
    std::uint32_t bits = 0;
    for (std::size_t i = 4; i-- > 0;) bits = bits * 256 + reference::byte_at(*ypr, at + i);
    return static_cast<double>(std::bit_cast<float>(bits));
  };
  EXPECT_NEAR(value(0), 43.5787, 5e-5);  // half of the last digit printed in docs/protocols/vectornav.md
  EXPECT_NEAR(value(4), 1.8847, 5e-5);
  EXPECT_NEAR(value(8), -0.0020, 5e-5);
  EXPECT_FALSE(field(binary, kCommon, kAcceleration));
  EXPECT_FALSE(decode_binary_measurement(binary));
}

TEST(VectorNavCodecTest, DecodesTheBinaryOutputThatTheDriverSets) {
  const std::string bytes = reference::data_message(1'234'567'890'123, 0.5F, -9.75F, 1.0F, 31.5F);
  for (const std::size_t piece : {std::size_t{1}, std::size_t{5}, bytes.size()}) {
    MessageParser parser(binary_header({0x0101, 0, 0x0010, 0, 0, 0}));
    std::optional<Measurement> measurement;
    for (std::size_t at = 0; at < bytes.size(); at += piece) {
      parser.feed(std::string_view(bytes).substr(at, piece));
      if (const auto message = parser.next())
        measurement = decode_binary_measurement(std::get<BinaryMessage>(*message));
    }
    ASSERT_TRUE(measurement);
    EXPECT_EQ(measurement->acceleration_mps2, Eigen::Vector3d(0.5, -9.75, 1.0));
    EXPECT_EQ(measurement->temperature_degc, 31.5);
    EXPECT_EQ(measurement->time_startup_ns, 1'234'567'890'123U);
    EXPECT_EQ(parser.skipped_bytes(), 0U);
  }
  EXPECT_EQ(binary_size({0x0101, 0, 0x0010, 0, 0, 0}), bytes.size());
  EXPECT_EQ(binary_size({0x8000, 0, 0, 0, 0, 0}), std::nullopt) << "a field nobody knows";
}

TEST(VectorNavCodecTest, FindsFieldsBehindOthers) {
  BinaryMessage message;
  // Yaw pitch roll 12, acceleration 12, magnetic field and temperature and pressure 20; IMU acceleration 12.
  message.fields = {0x0508, 0, 0x0200, 0, 0, 0};
  std::string payload(56, '\0');
  payload.replace(12, 4, reference::float_bytes(2.0F));
  payload.replace(24 + 12, 4, reference::float_bytes(19.5F));
  payload.replace(44 + 8, 4, reference::float_bytes(-3.0F));
  message.payload = payload;
  EXPECT_EQ(*field(message, kImu, kImuAcceleration), std::string(8, '\0') + reference::float_bytes(-3.0F));
  const auto measurement = decode_binary_measurement(message);
  ASSERT_TRUE(measurement);
  EXPECT_EQ(measurement->acceleration_mps2, Eigen::Vector3d(2.0, 0.0, 0.0));
  EXPECT_EQ(measurement->temperature_degc, 19.5);
  message.fields = {0, 0, 0x0200, 0, 0, 0};
  message.payload = std::string_view(payload).substr(44);
  EXPECT_EQ(decode_binary_measurement(message)->acceleration_mps2, Eigen::Vector3d(0.0, 0.0, -3.0));
}

TEST(VectorNavCodecTest, DecodesEachLineOfMeasurements) {
  const auto imu = decode_text_measurement("VNIMU,+1,+2,+3,+4.5,-5.25,+6,+7,+8,+9,+21.5,+101.3");
  ASSERT_TRUE(imu);
  EXPECT_EQ(imu->acceleration_mps2, Eigen::Vector3d(4.5, -5.25, 6));
  EXPECT_EQ(imu->temperature_degc, 21.5);
  EXPECT_EQ(decode_text_measurement("VNACC,+00.100,-09.807,+00.002")->acceleration_mps2,
            Eigen::Vector3d(0.1, -9.807, 0.002));
  EXPECT_EQ(decode_text_measurement("VNMAR,1,2,3,4,5,6,7,8,9")->acceleration_mps2, Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(decode_text_measurement("VNQMR,1,2,3,4,5,6,7,8,9,10,11,12,13")->acceleration_mps2,
            Eigen::Vector3d(8, 9, 10));
  EXPECT_EQ(decode_text_measurement("VNACC,1,2,3,T00001234,S00A1")->acceleration_mps2,
            Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(decode_text_measurement("VNACC,1,2,3,T12")->acceleration_mps2, Eigen::Vector3d(1, 2, 3));
  EXPECT_TRUE(std::isnan(decode_text_measurement("VNACC,nan,2,3")->acceleration_mps2.x()));
}

TEST(VectorNavCodecTest, RefusesLinesOfMeasurementsThatHaveNotTheirNumbers) {
  for (const std::string_view line :
       {"VNACC", "VNACC,", "VNACC,1,2", "VNACC,1,2,3,4", "VNACC,1,2,x", "VNACC,1,2,3x", "VNACC,1,,3",
        "VNACC,1,2,++3", "VNACC,1,2,+-3", "VNACC,1,2,3,T", "VNACC,1,2,3,S1,T1", "VNIMU,1,2,3", "VNYPR,1,2,3",
        "", "VNRRG,18,1,2,3", "VNACC,1,2, 3"})
    EXPECT_FALSE(decode_text_measurement(line)) << line;
}

TEST(VectorNavCodecTest, RejectsEverySingleDamagedByteOfAMessage) {
  const std::string driver_header = binary_header({0x0101, 0, 0x0010, 0, 0, 0});
  const std::string good = reference::data_message(1, 1.0F, 2.0F, 3.0F);
  for (const std::string& message :
       {std::string(kRecorded), make_message("VNACC,+00.100,-09.807,+00.002", Checksum::kCrc16),
        reference::data_message(77'777'777, 0.25F, -9.8F, 0.125F)}) {
    const auto undamaged = parse(message + good, 1000, driver_header);
    ASSERT_EQ(undamaged.size(), 2U);
    for (std::size_t at = 0; at < message.size(); ++at) {
      for (unsigned change = 1; change < 256; ++change) {
        // A line feed alone ends a message as well, whose content is then undamaged.
        if (message[at] == '\r' && change == ('\r' ^ '\n')) continue;
        std::string damaged = message;
        damaged[at] = static_cast<char>(static_cast<unsigned char>(damaged[at]) ^ change);
        const auto found = parse(damaged + good, 1000, driver_header);
        ASSERT_EQ(found.size(), 1U) << "byte " << at << " changed by " << change;
        ASSERT_EQ(found.front(), undamaged.back());
      }
    }
  }
}

TEST(VectorNavCodecTest, FindsMessagesInGarbageByteByByte) {
  const std::string garbage = "ue\x80$VN\xFA\xFA\x01$$VNACC,1,2,3*\r\n\x01\xFA\xFF";
  const std::string bytes = garbage + std::string(kRecorded) + garbage + kManualExample + garbage +
                            make_message("VNERR,08", Checksum::kXor8) +
                            std::string(64, ' ');  // False beginnings claim bytes: let them come.
  const auto expected = reference::decode(bytes);
  ASSERT_EQ(expected.messages.size(), 3U);
  for (std::size_t piece = 1; piece < 40; ++piece) EXPECT_EQ(parse(bytes, piece).size(), 3U) << piece;
}

TEST(VectorNavCodecTest, FindsAMessageBehindAFalseBeginningOnceTheLineIsSilent) {
  MessageParser parser;
  parser.feed(std::string("\xFA\x01\xFF\x0F", 4) + make_message("VNRRG,01,VN-100", Checksum::kXor8));
  EXPECT_FALSE(parser.next());
  EXPECT_TRUE(parser.has_partial());
  const auto message = parser.next_behind_partial();
  ASSERT_TRUE(message);
  EXPECT_EQ(std::get<TextMessage>(*message).text, "VNRRG,01,VN-100");
  EXPECT_EQ(parser.skipped_bytes(), 4U);
  EXPECT_FALSE(parser.has_partial());
}

TEST(VectorNavCodecTest, TakesOnlyTheBinaryMessagesItIsToldTo) {
  const std::string driver_header = binary_header({0x0101, 0, 0x0010, 0, 0, 0});
  EXPECT_TRUE(parse(kManualExample, 3, driver_header).empty());
  EXPECT_EQ(parse(kManualExample, 3).size(), 1U);
}

TEST(VectorNavCodecTest, ALineFeedAloneEndsAMessage) {
  const std::string bytes = "$VNRRG,01*72\n$VNRRG,01*E15F\n$VNRRG,54*72\r\n";
  MessageParser parser;
  parser.feed(bytes);
  std::size_t size = 0;
  for (const auto& [text, checksum] :
       {std::pair{"VNRRG,01", Checksum::kXor8}, std::pair{"VNRRG,01", Checksum::kCrc16},
        std::pair{"VNRRG,54", Checksum::kXor8}}) {
    const auto message = parser.next();
    ASSERT_TRUE(message);
    EXPECT_EQ(std::get<TextMessage>(*message).text, text);
    EXPECT_EQ(std::get<TextMessage>(*message).checksum, checksum);
    size += wire_size(*message);
  }
  EXPECT_EQ(size, bytes.size());
  EXPECT_EQ(parser.skipped_bytes(), 0U);
}

TEST(VectorNavCodecTest, SaysErrorsInWords) {
  EXPECT_EQ(error_in_words(0x08), "invalid register");
  EXPECT_EQ(error_in_words(0x0C), "the baud rate is insufficient for this output");
  EXPECT_EQ(error_in_words(0x42), "no meaning known");
}

TEST(VectorNavCodecTest, SplitsWords) {
  EXPECT_THAT(split_words("VNRRG,01,,x"), ElementsAre("VNRRG", "01", "", "x"));
  EXPECT_THAT(split_words(""), ElementsAre(""));
}

TEST(VectorNavCodecTest, DecodesEveryLineOfTheRecording) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "wire/vectornav_ymr.txt");
  std::ifstream file(path);
  std::string bytes;
  std::vector<Eigen::Vector3d> expected;
  for (std::string line; std::getline(file, line);) {
    bytes += line + "\r\n";  // The recorder kept the LF alone.
    double skip[6];
    double x = 0.0;
    double y = 0.0;
    double z = 0.0;
    ASSERT_EQ(std::sscanf(line.c_str(), "$VNYMR,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &skip[0], &skip[1],
                          &skip[2], &skip[3], &skip[4], &skip[5], &x, &y, &z),
              9);
    expected.emplace_back(x, y, z);
  }
  ASSERT_EQ(expected.size(), 163U);  // From the README of the shared data.
  for (const std::size_t piece : {std::size_t{1}, std::size_t{64}, bytes.size()}) {
    const auto texts = parse(bytes, piece);
    ASSERT_EQ(texts.size(), expected.size());
    for (std::size_t i = 0; i < texts.size(); ++i) {
      const auto measurement = decode_text_measurement(texts[i]);
      ASSERT_TRUE(measurement);
      EXPECT_EQ(measurement->acceleration_mps2, expected[i]);
    }
  }
}

}  // namespace
}  // namespace abcal::vectornav
