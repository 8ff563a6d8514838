#include "drivers/microstrain_mip/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <random>

#include "tests/drivers/microstrain_mip/reference_decoder.h"
#include "tests/support/test_data.h"

namespace abcal::mip {
namespace {

namespace reference = test::mip_reference;
using ::testing::ElementsAre;

std::string from_hex(std::string_view hex) {
  std::string bytes;
  std::string pair;
  for (const char digit : hex) {
    if (digit == ' ') continue;
    pair += digit;
    if (pair.size() < 2) continue;
    bytes += static_cast<char>(std::stoi(pair, nullptr, 16));
    pair.clear();
  }
  return bytes;
}

/// Output of the parser in the form of the reference decoder; fed in pieces of the given sizes, over and
/// over.
struct Parsed {
  std::vector<reference::FoundPacket> packets;
  std::uint64_t bad_frames = 0;
  std::uint64_t skipped_bytes = 0;
};

Parsed parse(std::string_view bytes, const std::vector<std::size_t>& pieces) {
  Parsed parsed;
  PacketParser parser;
  std::size_t used = 0;
  for (std::size_t i = 0; !bytes.empty(); i = (i + 1) % pieces.size()) {
    const std::size_t size = std::min(pieces[i], bytes.size());
    parser.feed(bytes.substr(0, size));
    bytes.remove_prefix(size);
    while (const auto packet = parser.next()) {
      parsed.packets.push_back(
          {used + parser.skipped_bytes(), packet->descriptor_set, std::string(packet->payload)});
      used += packet->payload.size() + kPacketOverhead;
    }
  }
  parsed.bad_frames = parser.bad_frames();
  parsed.skipped_bytes = parser.skipped_bytes();
  return parsed;
}

void expect_same_as_reference(std::string_view bytes, const std::vector<std::size_t>& pieces) {
  const reference::Decoded expected = reference::decode(bytes);
  const Parsed parsed = parse(bytes, pieces);
  ASSERT_EQ(parsed.packets.size(), expected.packets.size());
  for (std::size_t i = 0; i < expected.packets.size(); ++i) {
    ASSERT_EQ(parsed.packets[i], expected.packets[i]) << "packet " << i;
  }
  EXPECT_EQ(parsed.bad_frames, expected.bad_frames);
  EXPECT_EQ(parsed.skipped_bytes, expected.skipped_bytes);
}

std::string read_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Frames of docs/protocols/mip.md: third-party origin, and those sent by the maker's SDK.

TEST(MipCodecTest, BuildsThePacketsThatTheMakersSdkSends) {
  EXPECT_EQ(make_packet(0x01, {make_field(0x01)}), from_hex("756501020201E0C6"));
  EXPECT_EQ(make_packet(0x01, {make_field(0x02)}), from_hex("756501020202E1C7"));
  EXPECT_EQ(make_packet(0x01, {make_field(0x03)}), from_hex("756501020203E2C8"));
  EXPECT_EQ(make_packet(0x01, {make_field(0x04)}), from_hex("756501020204E3C9"));
  EXPECT_EQ(make_packet(0x01, {make_field(0x06)}), from_hex("756501020206E5CB"));
  EXPECT_EQ(make_packet(0x0C, {make_field(0x30, u8(5))}), from_hex("75650C03033005 2147"));
  EXPECT_EQ(make_packet(0x0C, {make_field(0x06)}), from_hex("75650C020206F0F7"));
  EXPECT_EQ(make_packet(0x0C, {make_field(0x0E, u8(0x80))}), from_hex("75650C03030E807A7E"));
  EXPECT_EQ(make_packet(0x0C, {make_field(0x08, legacy_message_format({{0x04, 500}, {0x05, 500}}))}),
            from_hex("75650C0A0A0801020401F40501F4F839"));
  EXPECT_EQ(make_packet(0x0C, {make_field(0x0F, message_format(0x80, {{0x04, 500}, {0x05, 500}}))}),
            from_hex("75650C0B0B0F0180020401F40501F48199"));
}

TEST(MipCodecTest, BuildsTheFramesOfTheThirdPartyCheckFile) {
  EXPECT_EQ(make_packet(0x0C, {make_field(0x0F, message_format(0x80, {{0xD5, 10}, {0x04, 10}, {0x05, 10}}))}),
            from_hex("75650C0E 0E0F018003 D5000A 04000A 05000A 91CE"));
  EXPECT_EQ(make_packet(0x0C, {make_field(0x0D, from_hex("0080 03 D5 04 05"))}),
            from_hex("75650C08 080D008003D50405 6446"));
}

TEST(MipCodecTest, PutsSeveralFieldsIntoOnePacket) {
  const std::string speed = make_field(0x09, u8(1) + u8(1) + u32(115200));
  EXPECT_EQ(make_packet(0x01, {make_field(0x01), speed, speed, speed}),
            from_hex("7565011A 0201 080901010001C200 080901010001C200 080901010001C200 7A91"));
}

TEST(MipCodecTest, RefusesWhatDoesNotFitIntoAPacket) {
  EXPECT_EQ(make_field(0x01, std::string(253, 'x')).size(), 255U);
  EXPECT_THROW(make_field(0x01, std::string(254, 'x')), std::invalid_argument);
  const std::string half = make_field(0x01, std::string(126, 'x'));
  EXPECT_THROW(make_packet(0x01, {half, half}), std::invalid_argument);
}

TEST(MipCodecTest, ReadsTheAcknowledgementsOfRealDevices) {
  const std::map<std::string, std::uint8_t> acks{
      {"7565010404F10100D56A", 0x01}, {"7565010404F10200D66C", 0x02}, {"7565010404F10600DA74", 0x06}};
  for (const auto& [hex, command] : acks) {
    PacketParser parser;
    parser.feed(from_hex(hex));
    const auto packet = parser.next();
    ASSERT_TRUE(packet) << hex;
    EXPECT_EQ(packet->descriptor_set, kBaseSet);
    const auto fields = split_fields(packet->payload);
    ASSERT_TRUE(fields);
    ASSERT_EQ(fields->size(), 1U);
    EXPECT_EQ(fields->front().descriptor, kAckField);
    const auto ack = decode_acknowledgement(fields->front().data);
    ASSERT_TRUE(ack);
    EXPECT_EQ(ack->command, command);
    EXPECT_EQ(ack->code, 0);
  }
}

TEST(MipCodecTest, DecodesTheDataPacketOfTheCheckFile) {
  PacketParser parser;
  parser.feed(
      from_hex("7565804C 0AD5000000055EE67CC0 0AD6000000014E434A00 0E043D9EE88D387FDB00BF7AAF03"
               "0E05BB0C1E30BB572E68BBAA24AE 0E07BC8AAC80BC72C50EBCC4E2C1"
               "0E083EEE3D9FBD66DADDC0AFDEF5 9196"));
  const auto packet = parser.next();
  ASSERT_TRUE(packet);
  EXPECT_EQ(packet->descriptor_set, kSensorSet);
  const auto fields = split_fields(packet->payload);
  ASSERT_TRUE(fields);
  ASSERT_EQ(fields->size(), 6U);
  EXPECT_EQ((*fields)[0].descriptor, kReferenceTime);
  EXPECT_EQ(decode_reference_time((*fields)[0].data), 23067000000U);
  EXPECT_EQ((*fields)[2].descriptor, kScaledAccelerometer);
  const auto acceleration = decode_scaled_accelerometer((*fields)[2].data);
  ASSERT_TRUE(acceleration);
  // Half of the last digit printed in docs/protocols/mip.md.
  EXPECT_NEAR(acceleration->x(), 0.077592, 5e-7);
  EXPECT_NEAR(acceleration->y(), 0.000061, 5e-7);
  EXPECT_NEAR(acceleration->z(), -0.979233, 5e-7);
  EXPECT_EQ((*fields)[3].descriptor, 0x05);
  const auto rate = decode_scaled_accelerometer((*fields)[3].data);  // Also three floats.
  ASSERT_TRUE(rate);
  EXPECT_NEAR(rate->x(), -0.002138, 5e-7);
  EXPECT_NEAR(rate->y(), -0.003283, 5e-7);
  EXPECT_NEAR(rate->z(), -0.005192, 5e-7);
}

TEST(MipCodecTest, DecodesEveryFieldOnlyAtItsOwnLength) {
  const std::string bytes(300, '\x01');
  const std::string_view data(bytes);
  for (std::size_t length = 0; length <= 255; ++length) {
    const std::string_view field = data.substr(0, length);
    EXPECT_EQ(decode_scaled_accelerometer(field).has_value(), length == 12);
    EXPECT_EQ(decode_temperature(field).has_value(), length == 12);
    EXPECT_EQ(decode_gps_timestamp(field).has_value(), length == 12);
    EXPECT_EQ(decode_over_range(field).has_value(), length == 2);
    EXPECT_EQ(decode_reference_time(field).has_value(), length == 8);
    EXPECT_EQ(decode_device_info(field).has_value(), length == 82);
    EXPECT_EQ(decode_descriptors(field).has_value(), length % 2 == 0);
    EXPECT_EQ(decode_acknowledgement(field).has_value(), length == 2);
    EXPECT_EQ(decode_u16(field).has_value(), length == 2);
  }
}

TEST(MipCodecTest, DecodesTemperatureTimestampOverRangeAndInfo) {
  const auto temperature = decode_temperature(reference::float_bytes(20.5F) + reference::float_bytes(23.25F) +
                                              reference::float_bytes(22.0F));
  ASSERT_TRUE(temperature);
  EXPECT_EQ(temperature->min_degc, 20.5);
  EXPECT_EQ(temperature->max_degc, 23.25);
  EXPECT_EQ(temperature->mean_degc, 22.0);

  const auto timestamp = decode_gps_timestamp(
      reference::bytes_of(std::bit_cast<std::uint64_t>(345600.125), 8) + from_hex("0898 0006"));
  ASSERT_TRUE(timestamp);
  EXPECT_EQ(timestamp->time_of_week_s, 345600.125);
  EXPECT_EQ(timestamp->week, 2200);
  EXPECT_EQ(timestamp->flags, 6);

  EXPECT_EQ(decode_over_range(from_hex("1234")), 0x1234);
  EXPECT_TRUE(accelerometer_over_range(0x0004));
  EXPECT_FALSE(accelerometer_over_range(0x1770));  // Gyroscope, magnetometer, barometer.

  const auto info =
      decode_device_info(from_hex("044F") + "      3DM-GX5-25" + "6253-4220       " +
                         std::string("  6253.12345\0\0\0\0", 16) + std::string(16, ' ') + "5g, 300d/s      ");
  ASSERT_TRUE(info);
  EXPECT_EQ(info->firmware, 1103);
  EXPECT_EQ(info->model_name, "3DM-GX5-25");
  EXPECT_EQ(info->model_number, "6253-4220");
  EXPECT_EQ(info->serial_number, "6253.12345");
  EXPECT_EQ(info->lot_number, "");
  EXPECT_EQ(info->options, "5g, 300d/s");

  const auto descriptors = decode_descriptors(from_hex("0101 8004 80D5"));
  ASSERT_TRUE(descriptors);
  EXPECT_THAT(*descriptors, ElementsAre(0x0101, 0x8004, 0x80D5));
}

TEST(MipCodecTest, ReadsNanAndInfinityAsTheyAre) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  const auto value = decode_scaled_accelerometer(
      reference::float_bytes(nan) + reference::float_bytes(infinity) + reference::float_bytes(-0.0F));
  ASSERT_TRUE(value);
  EXPECT_TRUE(std::isnan(value->x()));
  EXPECT_TRUE(std::isinf(value->y()));
  EXPECT_TRUE(std::signbit(value->z()));
}

TEST(MipCodecTest, RefusesFieldsWhoseLengthPointsOutOfThePacket) {
  EXPECT_TRUE(split_fields(""));
  EXPECT_TRUE(split_fields(from_hex("02 01")));
  EXPECT_FALSE(split_fields(from_hex("00 01")));
  EXPECT_FALSE(split_fields(from_hex("01 01")));
  EXPECT_FALSE(split_fields(from_hex("02")));
  EXPECT_FALSE(split_fields(from_hex("03 01")));
  EXPECT_FALSE(split_fields(from_hex("02 01 04 05 00")));
}

TEST(MipPacketParserTest, FindsThePacketBehindAFalseSyncThatClaimsIt) {
  const std::string ping = make_packet(0x01, {make_field(0x01)});
  // The false packet's claimed length covers the good one wholly.
  const std::string bytes = from_hex("7565 80 0E") + ping + std::string(20, '\0');
  PacketParser parser;
  parser.feed(bytes);
  const auto packet = parser.next();
  ASSERT_TRUE(packet);
  EXPECT_EQ(packet->descriptor_set, 0x01);
  EXPECT_EQ(parser.skipped_bytes(), 4U);
  EXPECT_EQ(parser.bad_frames(), 1U);
}

TEST(MipPacketParserTest, FindsAnAnswerBehindAFalseSyncOnceTheLineIsSilent) {
  const std::string ping = make_packet(0x01, {make_field(0x01)});
  PacketParser parser;
  parser.feed(from_hex("7565 80 FF") + ping);
  EXPECT_FALSE(parser.next());
  EXPECT_TRUE(parser.has_partial());
  const auto packet = parser.next_behind_partial();
  ASSERT_TRUE(packet);
  EXPECT_EQ(packet->descriptor_set, 0x01);
  EXPECT_EQ(parser.skipped_bytes(), 4U);
  EXPECT_FALSE(parser.has_partial());
}

TEST(MipPacketParserTest, KeepsAPartialPacketWhenNothingWholeLiesBehindIt) {
  const std::string ping = make_packet(0x01, {make_field(0x01)});
  PacketParser parser;
  parser.feed(ping.substr(0, 5));
  EXPECT_FALSE(parser.next());
  EXPECT_FALSE(parser.next_behind_partial());
  parser.feed(ping.substr(5));
  EXPECT_TRUE(parser.next());
  EXPECT_EQ(parser.skipped_bytes(), 0U);
}

TEST(MipPacketParserTest, DecodesTheRecordedStreamWhateverTheSplit) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "wire/mip_stream.bin");
  const std::string bytes = read_file(path);
  ASSERT_EQ(bytes.size(), 368940U);
  for (const std::vector<std::size_t>& pieces :
       std::vector<std::vector<std::size_t>>{{bytes.size()}, {1}, {7, 64, 1, 261, 1000}}) {
    std::map<unsigned, int> by_set;
    std::vector<Eigen::Vector3d> accelerations;
    const Parsed parsed = parse(bytes, pieces);
    for (const reference::FoundPacket& packet : parsed.packets) {
      ++by_set[packet.set];
      const auto fields = split_fields(packet.payload);
      ASSERT_TRUE(fields);
      for (const Field& field : *fields) {
        if (packet.set != kSensorSet || field.descriptor != kScaledAccelerometer) continue;
        const auto acceleration = decode_scaled_accelerometer(field.data);
        ASSERT_TRUE(acceleration);
        accelerations.push_back(*acceleration);
      }
    }
    // From the README of the shared data.
    EXPECT_EQ(parsed.packets.size(), 8384U);
    EXPECT_EQ(by_set, (std::map<unsigned, int>{{0x01, 1}, {0x80, 7157}, {0x82, 714}, {0xA0, 512}}));
    EXPECT_EQ(parsed.bad_frames, 0U);
    EXPECT_EQ(parsed.skipped_bytes, 0U);
    ASSERT_EQ(accelerations.size(), 4473U);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& acceleration : accelerations) sum += acceleration;
    const Eigen::Vector3d mean = sum / 4473.0;
    const Eigen::Vector3d first(0.01741764, -0.00666524, -0.98564005);
    const Eigen::Vector3d expected_mean(-0.05059853, -0.05818876, -0.94461641);
    for (int i = 0; i < 3; ++i) {
      EXPECT_NEAR(accelerations.front()(i), first(i), 5e-9);  // Half of the last digit printed.
      EXPECT_NEAR(mean(i), expected_mean(i), 5e-9);
    }
  }
}

/// Garbage, with many syncs among it, put in; bytes left out; bits turned over.
std::string damaged(std::string bytes, std::mt19937& random, int faults) {
  for (int i = 0; i < faults; ++i) {
    const std::size_t at = random() % bytes.size();
    switch (random() % 4) {
      case 0: {
        std::string garbage;
        for (std::size_t n = random() % 40; n > 0; --n) {
          garbage += random() % 4 == 0 ? std::string("ue") : std::string(1, static_cast<char>(random()));
        }
        bytes.insert(at, garbage);
        break;
      }
      case 1:
        bytes.erase(at, 1 + random() % 60);
        break;
      default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << (random() % 8)));
        break;
    }
  }
  return bytes;
}

TEST(MipPacketParserTest, FindsInADamagedStreamWhatTheSlowReferenceFindsAtTheSamePlaces) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "wire/mip_stream.bin");
  const std::string recorded = read_file(path);
  for (unsigned seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    const std::string part = recorded.substr(random() % (recorded.size() - 12000), 12000);
    const std::string bytes = damaged(part, random, static_cast<int>(random() % 200));
    expect_same_as_reference(bytes, {1 + random() % 400, 1 + random() % 9});
    if (HasFatalFailure()) return;
  }
}

TEST(MipPacketParserTest, AgreesWithTheReferenceOnNoiseFullOfSyncs) {
  for (unsigned seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    std::string bytes;
    while (bytes.size() < 4000) {
      switch (random() % 4) {
        case 0:
          bytes += "ue";
          break;
        case 1:  // A good packet, with a sync inside as often as not.
          bytes += reference::packet(random() % 256, std::string(random() % 30, random() % 2 ? 'u' : 'e'));
          break;
        case 2:
          bytes += static_cast<char>(random() % 8);  // A small length.
          break;
        default:
          bytes += static_cast<char>(random());
      }
    }
    expect_same_as_reference(bytes, {1 + random() % 20});
    if (HasFatalFailure()) return;
  }
}

}  // namespace
}  // namespace abcal::mip
