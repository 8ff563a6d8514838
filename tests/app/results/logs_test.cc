// Logs of other programs: each gives the same poses as the table of its readings. The bytes are written here
// after the published formats, not by the readers' code.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "app/results/logs/log_table.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sqlite.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

struct Row {
  std::uint64_t time_ns;
  double x, y, z;
};

/// Twelve poses of 5 s at 50 Hz, moved between them.
std::vector<Row> rows() {
  constexpr double kG = 9.81;
  std::vector<Row> list;
  for (int pose = 0; pose < 12; ++pose) {
    const double a = 0.5 * pose, b = 0.9 * pose;
    for (int i = 0; i < 290; ++i) {
      const double moved = i >= 250 ? 3.0 * std::sin(0.4 * i) : 0.0;
      const double noise = 1e-3 * std::sin(12.9898 * static_cast<double>(list.size()));
      list.push_back({1'700'000'000'000'000'000U + list.size() * 20'000'000U,
                      kG * std::cos(a) * std::cos(b) + moved + noise,
                      kG * std::sin(a) * std::cos(b) - moved - noise,
                      kG * std::sin(b) + moved + 2.0 * noise});
    }
  }
  return list;
}

template <class Number>
std::string raw(Number number) {
  std::string bytes(sizeof number, '\0');
  std::memcpy(bytes.data(), &number, sizeof number);
  return bytes;
}
template <class Number>
std::string reversed(Number number) {
  std::string bytes = raw(number);
  return {bytes.rbegin(), bytes.rend()};
}
std::string with_length(const std::string& text) {
  return raw(static_cast<std::uint32_t>(text.size())) + text;
}

class LogsTest : public testing::Test {
 protected:
  std::filesystem::path written(const std::string& name, const std::string& bytes) {
    std::ofstream(folder / name, std::ios::binary) << bytes;
    return folder / name;
  }
  /// The means of all poses.
  static std::vector<double> poses(const ImportedTable& table) {
    std::vector<double> means;
    for (const DwellRecord& dwell : table.record.dwells)
      for (const double mean : dwell.mean) means.push_back(mean);
    return means;
  }
  std::vector<double> expected() {
    std::string text = "# response_unit: m/s2\nt,x,y,z\n";
    for (const Row& row : list)
      text += fmt::format("{},{},{},{}\n", static_cast<double>(row.time_ns - list.front().time_ns) * 1e-9,
                          row.x, row.y, row.z);
    std::istringstream in(text);
    return poses(import_table(in, "table"));
  }
  void expect_same(const std::filesystem::path& path, const TableOptions& options = {}) {
    const std::vector<double> found = poses(import_readings(path, options)), wanted = expected();
    ASSERT_EQ(wanted.size(), 36U);
    // Times in other units may move the ends of a stretch of 200 readings, with noise of 1e-3, by one of
    // them; floats have 24 bits.
    constexpr double kEndsAndFloats = 3e-5;
    ASSERT_EQ(found.size(), wanted.size());
    for (std::size_t i = 0; i < found.size(); ++i) EXPECT_NEAR(found[i], wanted[i], kEndsAndFloats) << i;
  }
  static std::string refusal(const std::filesystem::path& path, const TableOptions& options = {}) {
    try {
      (void)import_readings(path, options);
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    ADD_FAILURE() << path << " was read";
    return {};
  }

  test::TemporaryFolder folder;
  std::vector<Row> list = rows();
};

// ---- NumPy

std::string numpy(const std::string& header, const std::string& data) {
  return "\x93NUMPY" + std::string("\x01\x00", 2) + raw(static_cast<std::uint16_t>(header.size())) + header +
         data;
}

TEST_F(LogsTest, AnArrayInAnyOrderOfItsNumbers) {
  std::string by_rows, big, times, readings[3];
  for (const Row& row : list) {
    const double t = static_cast<double>(row.time_ns - list.front().time_ns) * 1e-9;
    for (const double value : {t, row.x, row.y, row.z}) {
      by_rows += raw(value);
      big += reversed(value);
    }
    times += raw(t);
    readings[0] += raw(row.x), readings[1] += raw(row.y), readings[2] += raw(row.z);
  }
  const std::string by_columns = times + readings[0] + readings[1] + readings[2];
  const auto header = [&](const char* type, const char* fortran, const std::string& shape) {
    return fmt::format("{{'descr': '{}', 'fortran_order': {}, 'shape': ({}), }}\n", type, fortran, shape);
  };
  const std::string long_shape = fmt::format("{}, 4", list.size()), wide = fmt::format("4, {}", list.size());
  const TableOptions unit{.columns = {}, .unit = "m/s2", .time_unit = "s", .topic = {}};
  expect_same(written("a.npy", numpy(header("<f8", "False", long_shape), by_rows)), unit);
  expect_same(written("b.npy", numpy(header(">f8", "False", long_shape), big)), unit);
  expect_same(written("f.npy", numpy(header("<f8", "True", long_shape), by_columns)), unit);
  expect_same(written("w.npy", numpy(header("<f8", "False", wide), by_columns)), unit);
  expect_same(written("v.npy", numpy(header("<f8", "True", wide), by_rows)), unit);
}

TEST_F(LogsTest, AnArrayWithNamesOfItsColumns) {
  std::string data;
  for (const Row& row : list)
    data += raw(row.time_ns - list.front().time_ns) + raw(static_cast<float>(row.x)) +
            raw(static_cast<float>(row.y)) + raw(static_cast<float>(row.z)) + raw(std::int8_t{-3});
  const std::string header = fmt::format(
      "{{'descr': [('time_ns', '<u8'), ('acc_x', '<f4'), ('acc_y', '<f4'), ('acc_z', '<f4'), ('temp', "
      "'|i1')], "
      "'fortran_order': False, 'shape': ({},), }}\n",
      list.size());
  expect_same(written("s.npy", numpy(header, data)),
              {.columns = {}, .unit = "m/s2", .time_unit = {}, .topic = {}});
}

TEST_F(LogsTest, AnArrayThatIsNoneIsRefused) {
  const auto of = [&](const std::string& header, const std::string& data = std::string(800, '\0')) {
    return refusal(written("bad.npy", numpy(header, data)));
  };
  EXPECT_THAT(of("{'descr': '|O', 'fortran_order': False, 'shape': (10, 4), }"),
              HasSubstr("elements of the type |O"));
  EXPECT_THAT(of("{'descr': '<f8', 'fortran_order': False, 'shape': (10, 4, 2), }"),
              HasSubstr("3 dimensions"));
  EXPECT_THAT(of("{'descr': '<f8', 'fortran_order': False, 'shape': (100, 4), }"),
              HasSubstr("ends too early"));
  EXPECT_THAT(of("{'descr': '<f8', 'fortran_order': False, 'shape': (18446744073709551615, 4), }"),
              HasSubstr("ends too early"));
  EXPECT_THAT(of("{'descr': '<f8', 'fortran_order': False, 'shape': (5, 4611686018427387904), }"),
              HasSubstr("ends too early"));
  EXPECT_THAT(of("{'descr': '<f8', 'fortran_order': False, 'shape': (x, 4), }"),
              HasSubstr("the dimension x"));
}

// ---- ULog

std::string ulog_message(char type, const std::string& body) {
  return raw(static_cast<std::uint16_t>(body.size())) + type + body;
}

TEST_F(LogsTest, TheTopicOfAULogWithMostMessages) {
  std::string log = std::string("ULog\x01\x12\x35\x01", 8) + raw(std::uint64_t{0});
  log += ulog_message('B', std::string(40, '\0'));
  log += ulog_message('F', "inner:uint16_t a;uint8_t[3] b;");
  log += ulog_message('F', "sensor_accel:uint64_t timestamp;float x;float y;float z;");
  log += ulog_message('F',
                      "sensor_combined:uint64_t timestamp;inner[2] in;float[3] gyro_rad;float[3] "
                      "accelerometer_m_s2;uint8_t[4] "
                      "_padding0;");
  log += ulog_message('F', "sensor_gyro:uint64_t timestamp;float x;float y;float z;");
  log += ulog_message('A', raw(std::uint8_t{1}) + raw(std::uint16_t{7}) + "sensor_accel");
  log += ulog_message('A', raw(std::uint8_t{0}) + raw(std::uint16_t{8}) + "sensor_gyro");
  log += ulog_message('A', raw(std::uint8_t{0}) + raw(std::uint16_t{9}) + "sensor_combined");
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Row& row = list[i];
    const std::string time = raw((row.time_ns - list.front().time_ns) / 1000U);
    std::string readings;
    for (const double value : {row.x, row.y, row.z}) readings += raw(static_cast<float>(value));
    log += ulog_message(
        'D', raw(std::uint16_t{9}) + time + std::string(10, '\1') + std::string(12, '\2') + readings);
    log += ulog_message('D', raw(std::uint16_t{8}) + time + std::string(12, '\0'));
    if (i % 50 == 0) log += ulog_message('D', raw(std::uint16_t{7}) + time + readings);
  }
  const std::string cut = log + ulog_message('D', std::string(30, '\0')).substr(0, 11);  // Power was lost.
  expect_same(written("a.ulg", cut));
  const ImportedTable table = import_readings(folder / "a.ulg");
  EXPECT_THAT(table.record.read_as.front(),
              HasSubstr("ULog, topic sensor_combined of sensor_accel.1, sensor_combined"));
  EXPECT_EQ(table.record.response_unit, "m/s2");
  const TableOptions other{.columns = {}, .unit = {}, .time_unit = {}, .topic = "sensor_gyro"};
  EXPECT_THAT(refusal(folder / "a.ulg", other),
              AllOf(HasSubstr("found sensor_accel.1, sensor_combined"), HasSubstr("--topic")));
  log += ulog_message('D', raw(std::uint16_t{9}) + "short");
  EXPECT_THAT(refusal(written("b.ulg", log)), HasSubstr("shorter than its format"));
}

// ---- Bags

std::string field(const std::string& name, const std::string& value) {
  return with_length(name + "=" + value);
}
std::string bag_record(const std::string& header, const std::string& data) {
  return with_length(header) + with_length(data);
}
std::string connection(std::uint32_t id, const std::string& topic, const std::string& type) {
  return bag_record(field("op", "\x07") + field("conn", raw(id)) + field("topic", topic),
                    field("topic", topic) + field("type", type) + field("md5sum", "x"));
}
std::string stamp(std::uint64_t time_ns) {
  return raw(static_cast<std::uint32_t>(time_ns / 1'000'000'000U)) +
         raw(static_cast<std::uint32_t>(time_ns % 1'000'000'000U));
}
/// Orientation, rates and accelerations with their covariances.
std::string motion(const Row& row) {
  std::string bytes;
  for (int i = 0; i < 25; ++i) bytes += raw(0.25 * i);
  return bytes + raw(row.x) + raw(row.y) + raw(row.z) + std::string(72, '\0');
}
std::string bag_message(std::uint32_t id, const Row& row, bool with_stamp = true) {
  return bag_record(field("op", "\x02") + field("conn", raw(id)) + field("time", stamp(row.time_ns)),
                    raw(std::uint32_t{5}) + (with_stamp ? stamp(row.time_ns) : std::string(8, '\0')) +
                        with_length("imu_link") + motion(row));
}

TEST_F(LogsTest, ABagInChunksOrWithout) {
  const std::string head = "#ROSBAG V2.0\n" + bag_record(field("op", "\x03"), std::string(64, ' '));
  std::string chunk =
      connection(0, "/camera", "sensor_msgs/Image") + connection(1, "/imu", "sensor_msgs/Imu");
  std::string plain = chunk, unstamped = chunk;
  for (const Row& row : list) {
    chunk += bag_message(1, row);
    unstamped += bag_message(1, row, false);
  }
  const auto in_chunk = [&](const std::string& inner, const char* compression) {
    return bag_record(field("op", "\x05") + field("compression", compression) +
                          field("size", raw(static_cast<std::uint32_t>(inner.size()))),
                      inner);
  };
  expect_same(written("a.bag", head + in_chunk(chunk, "none")));
  expect_same(written("b.bag", head + chunk));
  expect_same(written("c.bag", head + in_chunk(unstamped, "none")));
  EXPECT_THAT(refusal(written("d.bag", head + in_chunk("BZh9", "bz2"))),
              AllOf(HasSubstr("compressed by bz2"), HasSubstr("rosbag decompress")));
  EXPECT_THAT(refusal(written("e.bag", head + chunk.substr(0, chunk.size() - 3))),
              HasSubstr("ends too early"));
  EXPECT_THAT(refusal(written("n.bag", head + connection(0, "/camera", "sensor_msgs/Image"))),
              HasSubstr("topic of sensor_msgs/Imu: found none"));
  chunk += connection(2, "/other", "sensor_msgs/Imu") + bag_message(2, list.front());
  EXPECT_THAT(refusal(written("t.bag", head + chunk)),
              AllOf(HasSubstr("found /imu, /other"), HasSubstr("--topic")));
  expect_same(folder / "t.bag", {.columns = {}, .unit = {}, .time_unit = {}, .topic = "/imu"});
}

TEST_F(LogsTest, ABagOfRos2IsNoRunFile) {
  const std::filesystem::path path = folder / "a.db3";
  {
    SqliteDatabase database(path, SqliteDatabase::Mode::kCreate);
    database.execute(
        "create table topics(id integer primary key, name text, type text, serialization_format text);"
        "create table messages(id integer primary key, topic_id integer, timestamp integer, data blob);"
        "insert into topics values(1, '/rosout', 'rcl_interfaces/msg/Log', 'cdr'),"
        "(2, '/imu', 'sensor_msgs/msg/Imu', 'cdr')");
    Transaction transaction(database);
    for (const Row& row : list) {
      std::string message =
          std::string("\x00\x01\x00\x00", 4) + stamp(row.time_ns) + with_length(std::string("imu\0", 4));
      message += std::string((8 - (message.size() - 4) % 8) % 8, '\0') + motion(row);
      SqliteStatement insertion =
          database.prepare("insert into messages(topic_id, timestamp, data) values(2, 0, ?)");
      insertion.bind_blob(1, message).run();
    }
    transaction.commit();
  }
  expect_same(path);
  EXPECT_FALSE(RunFile::looks_like_run_file(path));
  SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)
      .execute("update topics set serialization_format = 'json'");
  EXPECT_THAT(refusal(path), HasSubstr("found messages in the format json"));
}

TEST_F(LogsTest, APackedLogNamesItsConversion) {
  EXPECT_THAT(refusal(written("a.mcap", "\x89MCAP0\r\n")),
              AllOf(HasSubstr("an MCAP file"), HasSubstr("convert")));
  EXPECT_THAT(refusal(written("a.npz", "PK\x03\x04")), HasSubstr("ZIP archive"));
  EXPECT_THAT(refusal(written("a.gz", "\x1f\x8b\x08")), HasSubstr("gunzip"));
  EXPECT_THAT(refusal(written("a.db3.zstd", "\x28\xb5\x2f\xfd")), HasSubstr("zstd -d"));
}

}  // namespace
}  // namespace abcal
