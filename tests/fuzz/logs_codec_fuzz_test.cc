#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <random>
#include <string>

#include "tests/support/fuzz_inputs.h"

namespace abcal {
namespace {

template <class Number>
std::string raw(Number number) {
  std::string bytes(sizeof number, '\0');
  std::memcpy(bytes.data(), &number, sizeof number);
  return bytes;
}
std::string with_length(const std::string& text) {
  return raw(static_cast<std::uint32_t>(text.size())) + text;
}
std::string any_bytes(std::mt19937& random, std::size_t count) {
  std::string bytes;
  while (bytes.size() < count) bytes += static_cast<char>(random() % 256);
  return bytes;
}

std::string any_array(std::mt19937& random) {
  static const std::array<std::string, 5> kTypes{"'<f8'", "'>f4'", "'|i1'",
                                                 "[('t', '<i8'), ('x', '<f4'), ('y', '<f4')]", "'<U8'"};
  const std::string shape =
      random() % 2 == 0 ? "(" + std::to_string(random() % 9) + ", " + std::to_string(random() % 9) + ")"
                        : "(4,)";
  const std::string header = "{'descr': " + kTypes[random() % kTypes.size()] +
                             ", 'fortran_order': " + (random() % 2 == 0 ? "True" : "False") +
                             ", 'shape': " + shape + ", }";
  return "\x93NUMPY" + std::string("\x01\x00", 2) + raw(static_cast<std::uint16_t>(header.size())) + header +
         any_bytes(random, random() % 400);
}

std::string any_ulog(std::mt19937& random) {
  const auto message = [](char type, const std::string& body) {
    return raw(static_cast<std::uint16_t>(body.size())) + type + body;
  };
  std::string log = std::string("ULog\x01\x12\x35\x01", 8) + raw(std::uint64_t{0});
  log += message('F', "a:uint8_t b;a c;");
  log += message('F', "sensor_accel:uint64_t timestamp;uint16_t[" + std::to_string(random() % 4) +
                          "] u;float x;float y;float z;");
  log += message('A', raw(static_cast<std::uint8_t>(random() % 2)) + raw(std::uint16_t{7}) + "sensor_accel");
  for (std::size_t i = 0; i < random() % 6; ++i)
    log += message('D', raw(std::uint16_t{7}) + any_bytes(random, 20 + random() % 8));
  return log;
}

std::string any_bag(std::mt19937& random) {
  const auto field = [](const std::string& name, const std::string& value) {
    return with_length(name + "=" + value);
  };
  const auto record = [](const std::string& header, const std::string& data) {
    return with_length(header) + with_length(data);
  };
  std::string chunk =
      record(field("op", "\x07") + field("conn", raw(std::uint32_t{1})) + field("topic", "/imu"),
             field("topic", "/imu") + field("type", "sensor_msgs/Imu"));
  for (std::size_t i = 0; i < random() % 4; ++i)
    chunk += record(
        field("op", "\x02") + field("conn", raw(std::uint32_t{1})) + field("time", raw(std::uint64_t{i})),
        std::string(12, '\0') + with_length("imu") + any_bytes(random, 296 + random() % 8));
  return "#ROSBAG V2.0\n" +
         (random() % 2 == 0 ? chunk : record(field("op", "\x05") + field("compression", "none"), chunk));
}

std::string any_log(std::mt19937& random) {
  const auto kind = random() % 3;
  return kind == 0 ? any_array(random) : kind == 1 ? any_ulog(random) : any_bag(random);
}

TEST(LogsCodecFuzzTest, GivesATableOrWordsOnSeededLogs) {
  test::show_target_seeded(20261130, 3'000, any_log);
}

TEST(LogsCodecFuzzTest, GivesATableOrWordsOnChangedLogs) {
  test::show_target_seeded(20261201, 10'000, [](std::mt19937& random) {
    const std::string logs[] = {any_log(random)};
    return test::mutated(logs, 1, random);
  });
}

TEST(LogsCodecFuzzTest, GivesATableOrWordsOnEveryStartAndEnd) {
  std::mt19937 random(7);
  test::show_target_every_part(any_bag(random));
  test::show_target_every_part(any_ulog(random));
  test::show_target_every_part(any_array(random));
}

}  // namespace
}  // namespace abcal
