#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <stdexcept>

#include "app/results/logs/byte_reader.h"
#include "app/results/logs/log_table.h"
#include "protocol/record/sqlite.h"

namespace abcal {
namespace {

// Bag of ROS 1, version 2.0: http://wiki.ros.org/Bags/Format/2.0. Bag of ROS 2: tables of
// rosbag2_storage_sqlite3 with messages in CDR (OMG formal/02-06-51, 15.3).

constexpr const char* kTopicWords = "topic of sensor_msgs/Imu";
constexpr const char* kHead = "# response_unit: m/s2\n# time_unit: ns\nt,x,y,z\n";
constexpr std::int64_t kNanoseconds = 1'000'000'000;

/// Rows of a topic. Times begin with the first: those since 1970 in ns have more digits than a number keeps.
class ImuRows {
 public:
  /// @param time_ns  when the message was recorded, for one without a time of its own
  void add(std::int64_t own_time_ns, std::int64_t time_ns, ByteReader rest) {
    const std::int64_t time = own_time_ns != 0 ? own_time_ns : time_ns;
    if (count_++ == 0) first_ns_ = time;
    // Orientation and rates with their covariances come first: 4 + 9 + 3 + 9 numbers.
    constexpr std::size_t kBefore = 25 * sizeof(double);
    rest.skip(kBefore);
    const auto x = rest.number<double>(), y = rest.number<double>(), z = rest.number<double>();
    fmt::format_to(std::back_inserter(text_), "{},{},{},{}\n", time - first_ns_, x, y, z);
  }
  const std::string& text() const { return text_; }
  bool is_empty() const { return count_ == 0; }

 private:
  std::string text_;
  std::size_t count_ = 0;
  std::int64_t first_ns_ = 0;
};

LogTable table_of(const std::map<std::string, ImuRows>& topics, const std::string& asked,
                  const std::string& source, const char* format) {
  std::vector<std::string> names;
  for (const auto& [name, rows] : topics)
    if (!rows.is_empty()) names.push_back(name);
  const std::string chosen = chosen_topic(names, asked, source, kTopicWords);
  return {fmt::format("{}, topic {}", format, chosen), kHead + topics.at(chosen).text()};
}

class RosBagReader {
 public:
  RosBagReader(std::string_view bytes, const std::string& source) : bytes_(bytes), source_(source) {}

  std::map<std::string, ImuRows> read() {
    ByteReader bag(bytes_);
    bag.skip(std::string_view("#ROSBAG V2.0\n").size());
    read_records(bag, false);
    return std::move(topics_);
  }

 private:
  using Fields = std::map<std::string_view, std::string_view>;
  enum Op : unsigned char { kMessage = 2, kChunk = 5, kConnection = 7 };

  static Fields fields_of(std::string_view header) {
    Fields fields;
    ByteReader reader(header);
    while (!reader.at_end()) {
      const std::string_view field = reader.text(reader.number<std::uint32_t>());
      const std::size_t equals = field.find('=');
      if (equals != std::string_view::npos) fields[field.substr(0, equals)] = field.substr(equals + 1);
    }
    return fields;
  }
  template <class Number>
  static Number number_of(const Fields& fields, std::string_view name) {
    const auto found = fields.find(name);
    if (found == fields.end()) throw LogEnds();
    return ByteReader(found->second).number<Number>();
  }

  void read_records(ByteReader& records, bool in_chunk) {
    while (!records.at_end()) {
      const Fields fields = fields_of(records.text(records.number<std::uint32_t>()));
      const std::string_view data = records.text(records.number<std::uint32_t>());
      const auto op = number_of<unsigned char>(fields, "op");
      if (op == kChunk) {
        if (in_chunk) throw LogEnds();
        read_chunk(fields, data);
      } else if (op == kConnection) {
        const auto topic = fields.find("topic");
        const Fields connection = fields_of(data);
        const auto type = connection.find("type");
        if (topic != fields.end() && type != connection.end() && type->second == "sensor_msgs/Imu")
          topic_of_[number_of<std::uint32_t>(fields, "conn")] = topic->second;
      } else if (op == kMessage) {
        const auto topic = topic_of_.find(number_of<std::uint32_t>(fields, "conn"));
        if (topic != topic_of_.end())
          add(topics_[topic->second], number_of<std::uint64_t>(fields, "time"), data);
      }
    }
  }
  void read_chunk(const Fields& fields, std::string_view data) {
    const auto compression = fields.find("compression");
    if (compression != fields.end() && compression->second != "none")
      throw std::runtime_error(fmt::format(
          "{}: found a bag compressed by {}; required: one without compression (`rosbag decompress {}`)",
          source_, compression->second, source_));
    ByteReader chunk(data);
    read_records(chunk, true);
  }
  /// @param time  seconds in the lower half, nanoseconds in the upper one
  static void add(ImuRows& rows, std::uint64_t time, std::string_view message) {
    const auto ns_of = [](std::uint32_t seconds, std::uint32_t ns) {
      return std::int64_t{seconds} * kNanoseconds + std::int64_t{ns};
    };
    ByteReader reader(message);
    reader.skip(sizeof(std::uint32_t));  // Sequence number.
    const auto seconds = reader.number<std::uint32_t>(), ns = reader.number<std::uint32_t>();
    reader.skip(reader.number<std::uint32_t>());  // Name of the frame.
    rows.add(ns_of(seconds, ns),
             ns_of(static_cast<std::uint32_t>(time), static_cast<std::uint32_t>(time >> 32U)), reader);
  }

  std::string_view bytes_;
  const std::string& source_;
  std::map<std::uint32_t, std::string> topic_of_;
  std::map<std::string, ImuRows> topics_;
};

/// A message in CDR; numbers are aligned from the end of its four bytes of encapsulation.
void add_cdr(ImuRows& rows, std::int64_t time_ns, std::string_view message) {
  ByteReader encapsulation(message);
  encapsulation.skip(1);
  const auto kind = encapsulation.number<std::uint8_t>();
  encapsulation.skip(2);
  ByteReader reader(message.substr(encapsulation.position()),
                    kind % 2 == 0 ? std::endian::big : std::endian::little);
  const auto seconds = reader.number<std::int32_t>();
  const auto ns = reader.number<std::uint32_t>();
  reader.skip(reader.number<std::uint32_t>());  // Name of the frame.
  reader.align(sizeof(double));
  rows.add(std::int64_t{seconds} * kNanoseconds + std::int64_t{ns}, time_ns, reader);
}

[[noreturn]] void refuse_truncated(const std::string& source) {
  throw std::runtime_error(
      fmt::format("{}: a bag that ends too early, or is no bag; required: a whole bag (`rosbag reindex`, "
                  "`ros2 bag reindex`)",
                  source));
}

}  // namespace

LogTable ros_bag_table(std::string_view bytes, const std::string& source, const std::string& topic) try {
  return table_of(RosBagReader(bytes, source).read(), topic, source, "ROS bag");
} catch (const LogEnds&) {
  refuse_truncated(source);
}

LogTable ros2_bag_table(const std::filesystem::path& path, const std::string& topic) try {
  SqliteDatabase database(path, SqliteDatabase::Mode::kReadOnly);
  std::map<std::string, ImuRows> topics;
  SqliteStatement messages = database.prepare(
      "select topics.name as name, topics.serialization_format as format, messages.timestamp as time, "
      "messages.data as "
      "data from messages join topics on topics.id = messages.topic_id where topics.type = "
      "'sensor_msgs/msg/Imu' order by "
      "messages.id");
  const int data = messages.column("data");
  while (messages.step()) {
    if (const std::string format = messages.text("format"); format != "cdr")
      throw std::runtime_error(fmt::format(
          "{}: found messages in the format {}; required: cdr (`ros2 bag convert`)", path.string(), format));
    add_cdr(topics[messages.text("name")], messages.integer("time"), messages.blob(data));
  }
  return table_of(topics, topic, path.string(), "ROS 2 bag");
} catch (const LogEnds&) {
  refuse_truncated(path.string());
}

}  // namespace abcal
