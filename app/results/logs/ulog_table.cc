#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <stdexcept>
#include <utility>

#include "app/results/logs/byte_reader.h"
#include "app/results/logs/log_table.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

// ULog, version 1: https://docs.px4.io/main/en/dev_log/ulog_file_format.html

constexpr std::array<std::pair<std::string_view, std::size_t>, 12> kTypes{{{"int8_t", 1},
                                                                           {"uint8_t", 1},
                                                                           {"int16_t", 2},
                                                                           {"uint16_t", 2},
                                                                           {"int32_t", 4},
                                                                           {"uint32_t", 4},
                                                                           {"int64_t", 8},
                                                                           {"uint64_t", 8},
                                                                           {"float", 4},
                                                                           {"double", 8},
                                                                           {"bool", 1},
                                                                           {"char", 1}}};

struct Field {
  std::string type;
  std::size_t count = 1;
  std::string name;
};

/// Where a message of accelerations has its time and its three readings, in bytes from its beginning.
struct Layout {
  std::size_t time = 0;
  std::array<std::size_t, 3> readings{};
};

/// The fields of each type of message: 'F' messages of the log.
class Formats {
 public:
  /// @param text  "sensor_accel:uint64_t timestamp;float x;float[3] y;"
  void add(std::string_view text) {
    const std::size_t colon = text.find(':');
    std::vector<Field>& fields = fields_[std::string(text.substr(0, colon))];
    fields.clear();
    for (std::string_view part : pieces::split(text.substr(std::min(colon + 1, text.size())), ';')) {
      const std::size_t blank = part.find(' ');
      if (blank == std::string_view::npos) continue;
      Field& field = fields.emplace_back(
          Field{std::string(part.substr(0, blank)), 1, std::string(part.substr(blank + 1))});
      const std::size_t bracket = field.type.find('[');
      if (bracket == std::string::npos) continue;
      field.count = pieces::number<std::uint16_t>(
                        std::string_view(field.type).substr(bracket + 1, field.type.size() - bracket - 2))
                        .value_or(0);
      field.type.resize(bracket);
    }
  }

  /// Nothing if the message has no time and no three floats of acceleration.
  std::optional<Layout> layout(const std::string& message) const {
    std::map<std::string, std::pair<std::size_t, const Field*>, std::less<>> place;
    std::size_t at = 0;
    int visits = 0;
    const auto found = fields_.find(message);
    if (found == fields_.end()) return std::nullopt;
    for (const Field& field : found->second) {
      place[field.name] = {at, &field};
      const auto size = size_of(field.type, visits);
      if (!size) return std::nullopt;
      at += *size * field.count;
    }
    const auto of_type = [&](std::string_view name, std::string_view type,
                             std::size_t count) -> std::optional<std::size_t> {
      const auto field = place.find(name);
      if (field == place.end() || field->second.second->type != type || field->second.second->count != count)
        return std::nullopt;
      return field->second.first;
    };
    auto time = of_type("timestamp_sample", "uint64_t", 1);
    if (!time) time = of_type("timestamp", "uint64_t", 1);
    if (!time) return std::nullopt;
    if (const auto all = of_type("accelerometer_m_s2", "float", 3))
      return Layout{*time, {*all, *all + 4, *all + 8}};
    if (message.find("accel") == std::string::npos)
      return std::nullopt;  // Positions and rates are x, y, z as well.
    const auto x = of_type("x", "float", 1), y = of_type("y", "float", 1), z = of_type("z", "float", 1);
    if (!x || !y || !z) return std::nullopt;
    return Layout{*time, {*x, *y, *z}};
  }

 private:
  /// Bytes of a type; of one that consists of others, their sum. Nothing where the formats nest without end.
  std::optional<std::size_t> size_of(std::string_view type, int& visits) const {
    for (const auto& [name, size] : kTypes)
      if (name == type) return size;
    constexpr int kMostVisits = 1000;
    const auto nested = fields_.find(type);
    if (nested == fields_.end() || ++visits > kMostVisits) return std::nullopt;
    std::size_t sum = 0;
    for (const Field& field : nested->second) {
      const auto size = size_of(field.type, visits);
      if (!size) return std::nullopt;
      sum += *size * field.count;
    }
    return sum;
  }

  std::map<std::string, std::vector<Field>, std::less<>> fields_;
};

/// A topic that is logged, whose messages have accelerations.
struct Topic {
  std::string name;  ///< "sensor_accel", "sensor_accel.1"
  Layout layout;
  std::string text;  ///< Its rows.
  std::size_t rows = 0;
};

class UlogReader {
 public:
  explicit UlogReader(std::string_view bytes) : bytes_(bytes) {}

  /// Every topic with accelerations, by its number in the log.
  std::map<std::uint16_t, Topic> read() {
    constexpr std::size_t kHeader = 16;
    ByteReader log(bytes_);
    log.skip(kHeader);
    while (!log.at_end()) {
      std::size_t size = 0;
      char type = 0;
      std::string_view body;
      try {
        size = log.number<std::uint16_t>();
        type = log.number<char>();
        body = log.text(size);
      } catch (const LogEnds&) {
        break;  // The supply of a vehicle often ends before its log.
      }
      take(type, body);
    }
    return std::move(topics_);
  }

 private:
  void take(char type, std::string_view body) {
    ByteReader message(body);
    if (type == 'F') {
      formats_.add(body);
    } else if (type == 'A') {
      const auto instance = message.number<std::uint8_t>();
      const auto id = message.number<std::uint16_t>();
      const std::string name(message.text(message.left()));
      if (const auto layout = formats_.layout(name))
        topics_[id] = {instance == 0 ? name : fmt::format("{}.{}", name, instance), *layout, {}, 0};
    } else if (type == 'D') {
      const auto topic = topics_.find(message.number<std::uint16_t>());
      if (topic != topics_.end()) add_row(body.substr(message.position()), topic->second);
    }
  }

  void add_row(std::string_view data, Topic& topic) {
    const auto number_at = [&]<class Number>(std::size_t at, Number) {
      ByteReader reader(data);
      reader.skip(at);
      return reader.number<Number>();
    };
    const auto& [x, y, z] = topic.layout.readings;
    fmt::format_to(std::back_inserter(topic.text), "{},{},{},{}\n",
                   number_at(topic.layout.time, std::uint64_t{}), number_at(x, float{}),
                   number_at(y, float{}), number_at(z, float{}));
    ++topic.rows;
  }

  std::string_view bytes_;
  Formats formats_;
  std::map<std::uint16_t, Topic> topics_;
};

}  // namespace

LogTable ulog_table(std::string_view bytes, const std::string& source, const std::string& topic) try {
  const std::map<std::uint16_t, Topic> topics = UlogReader(bytes).read();
  std::vector<std::string> names;
  std::string asked = topic;
  std::size_t most = 0;
  for (const auto& [id, each] : topics) {
    if (each.rows > 0) names.push_back(each.name);
    if (topic.empty() && each.rows > most) asked = each.name, most = each.rows;
  }
  const std::string chosen = chosen_topic(names, asked, source, "topic with accelerations");
  LogTable table{fmt::format("ULog, topic {} of {}", chosen, fmt::join(names, ", ")),
                 "# response_unit: m/s2\n# time_unit: us\nt,x,y,z\n"};
  for (const auto& [id, each] : topics)
    if (each.name == chosen) table.text += each.text;
  return table;
} catch (const LogEnds&) {
  throw std::runtime_error(fmt::format(
      "{}: a ULog with a message that is shorter than its format; required: a sound log", source));
}

}  // namespace abcal
