#include "drivers/xsens_mti/codec.h"

#include <bit>
#include <stdexcept>

#include "drivers/text/names.h"

namespace abcal::xbus {
namespace {

constexpr char kPreamble = '\xFA';
constexpr char kBusId = '\xFF';  // The master device: the only one there is.
constexpr std::size_t kHeader = 4;
constexpr std::size_t kLongLength = 2;
constexpr unsigned kLengthIsLong = 0xFF;

unsigned byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<std::uint8_t>(bytes[index]);
}

template <typename Unsigned>
Unsigned big_endian(std::string_view bytes) {
  Unsigned value = 0;
  for (std::size_t i = 0; i < sizeof(Unsigned); ++i)
    value = static_cast<Unsigned>((value << 8U) | static_cast<Unsigned>(byte_at(bytes, i)));
  return value;
}

void put_u16(std::string& bytes, unsigned value) {
  bytes.push_back(static_cast<char>((value >> 8U) & 0xFFU));
  bytes.push_back(static_cast<char>(value & 0xFFU));
}

std::size_t bytes_of_real(std::uint16_t id) {
  constexpr std::size_t kBytes[] = {4, 4, 6, 8};
  return kBytes[id & 3U];
}

double real(std::uint16_t id, std::string_view bytes) {
  switch (id & 3U) {
    case 0:
      return static_cast<double>(std::bit_cast<float>(big_endian<std::uint32_t>(bytes)));
    case 1:
      return static_cast<double>(std::bit_cast<std::int32_t>(big_endian<std::uint32_t>(bytes))) / 1048576.0;
    case 2: {
      const double fraction = static_cast<double>(big_endian<std::uint32_t>(bytes)) / 4294967296.0;
      return static_cast<double>(std::bit_cast<std::int16_t>(big_endian<std::uint16_t>(bytes.substr(4)))) +
             fraction;
    }
    default:
      return std::bit_cast<double>(big_endian<std::uint64_t>(bytes));
  }
}

}  // namespace

std::uint8_t checksum(std::string_view bytes) {
  unsigned sum = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) sum += byte_at(bytes, i);
  return static_cast<std::uint8_t>(0U - sum);
}

std::string make_message(std::uint8_t id, std::string_view data) {
  if (data.size() > kMaxData) {
    throw std::invalid_argument("Xbus data of " + std::to_string(data.size()) + " bytes; at most " +
                                std::to_string(kMaxData) + " fit");
  }
  std::string message{kPreamble, kBusId, static_cast<char>(id)};
  if (data.size() < kLengthIsLong) {
    message.push_back(static_cast<char>(data.size()));
  } else {
    message.push_back(static_cast<char>(kLengthIsLong));
    put_u16(message, static_cast<unsigned>(data.size()));
  }
  message.append(data);
  message.push_back(static_cast<char>(checksum(std::string_view(message).substr(1))));
  return message;
}

std::optional<std::vector<Item>> split_items(std::string_view data) {
  constexpr std::size_t kItemHeader = 3;
  std::vector<Item> items;
  while (!data.empty()) {
    if (data.size() < kItemHeader) return std::nullopt;
    const std::size_t size = byte_at(data, 2);
    if (data.size() < kItemHeader + size) return std::nullopt;
    items.push_back({big_endian<std::uint16_t>(data), data.substr(kItemHeader, size)});
    data.remove_prefix(kItemHeader + size);
  }
  return items;
}

void MessageParser::feed(std::string_view bytes) {
  buffer_.erase(0, begin_);
  begin_ = 0;
  buffer_ += bytes;
}

MessageParser::Look MessageParser::look_at(std::size_t position) const {
  const std::string_view here = std::string_view(buffer_).substr(position);
  if (here[0] != kPreamble) return {};
  if (here.size() > 1 && here[1] != kBusId) return {};
  if (here.size() < kHeader) return {Found::kNeedsMore};
  std::size_t header = kHeader;
  std::size_t length = byte_at(here, 3);
  if (length == kLengthIsLong) {
    header += kLongLength;
    if (here.size() < header) return {Found::kNeedsMore};
    length = big_endian<std::uint16_t>(here.substr(kHeader));
    if (length > kMaxData) return {};
  }
  const std::size_t size = header + length + 1;
  if (here.size() < size) return {Found::kNeedsMore};
  const Message message{static_cast<std::uint8_t>(byte_at(here, 2)), here.substr(header, length)};
  const bool right = checksum(here.substr(1, size - 1)) == 0;
  const bool filled = message.id != kMtData2 || split_items(message.data).has_value();
  return {right && filled ? Found::kMessage : Found::kBad, message, size};
}

std::optional<Message> MessageParser::next() {
  for (; begin_ < buffer_.size(); ++begin_, ++skipped_bytes_) {
    const Look look = look_at(begin_);
    switch (look.found) {
      case Found::kMessage:
        begin_ += look.size;
        return look.message;
      case Found::kNeedsMore:
        return std::nullopt;
      case Found::kBad:
        ++bad_frames_;
        break;
      case Found::kNothingHere:
        break;
    }
  }
  return std::nullopt;
}

std::optional<Message> MessageParser::next_behind_partial() {
  for (std::size_t position = begin_; position < buffer_.size(); ++position) {
    const Look look = look_at(position);
    if (look.found != Found::kMessage) continue;
    skipped_bytes_ += position - begin_;
    begin_ = position + look.size;
    return look.message;
  }
  return std::nullopt;
}

std::optional<std::vector<double>> decode_reals(std::uint16_t id, std::string_view data, std::size_t count) {
  const std::size_t size = bytes_of_real(id);
  if (data.size() != count * size) return std::nullopt;
  std::vector<double> values;
  for (std::size_t i = 0; i < count; ++i) values.push_back(real(id, data.substr(i * size, size)));
  return values;
}

std::optional<Eigen::Vector3d> decode_acceleration(const Item& item) {
  const auto values = decode_reals(item.id, item.data, 3);
  if (!values) return std::nullopt;
  return Eigen::Vector3d((*values)[0], (*values)[1], (*values)[2]);
}

std::optional<double> decode_temperature(const Item& item) {
  const auto values = decode_reals(item.id, item.data, 1);
  if (!values) return std::nullopt;
  return values->front();
}

std::optional<std::uint16_t> decode_u16(std::string_view data) {
  if (data.size() != 2) return std::nullopt;
  return big_endian<std::uint16_t>(data);
}

std::optional<std::uint32_t> decode_u32(std::string_view data) {
  if (data.size() != 4) return std::nullopt;
  return big_endian<std::uint32_t>(data);
}

std::string output_configuration(const std::vector<Output>& outputs) {
  std::string data;
  for (const Output& output : outputs) {
    put_u16(data, output.id);
    put_u16(data, output.rate_hz);
  }
  return data;
}

std::optional<std::vector<Output>> decode_output_configuration(std::string_view data) {
  if (data.size() % 4 != 0) return std::nullopt;
  std::vector<Output> outputs;
  for (; !data.empty(); data.remove_prefix(4))
    outputs.push_back({big_endian<std::uint16_t>(data), big_endian<std::uint16_t>(data.substr(2))});
  return outputs;
}

constexpr auto kErrors = names<unsigned>({{0x03, "period not valid"},
                                          {0x04, "message not valid or not supported"},
                                          {0x1E, "timer overflow"},  // The maker's list has 30 in decimal.
                                          {0x20, "baud rate not valid"},
                                          {0x21, "parameter not valid"},
                                          {0x28, "device error"},
                                          {0x29, "more data than the link carries"}});

std::string_view error_in_words(unsigned code) {
  return kErrors.of(code, "no meaning known");
}

}  // namespace abcal::xbus
