#include "drivers/microstrain_mip/codec.h"

#include <bit>
#include <stdexcept>
#include <utility>

#include "drivers/text/names.h"
#include "drivers/text/text.h"

namespace abcal::mip {
namespace {

constexpr char kSync1 = 0x75;
constexpr char kSync2 = 0x65;
constexpr std::size_t kHeader = 4;  // Sync 2, set, length.
constexpr std::size_t kChecksum = 2;
constexpr std::size_t kUsualFields = 8;  // The vector of a packet of data need not grow.
constexpr std::uint8_t kWrite = 1;       // Function selector of commands that set or read something.

std::uint8_t byte_at(std::string_view bytes, std::size_t index) {
  return static_cast<std::uint8_t>(bytes[index]);
}

template <typename Unsigned>
Unsigned big_endian(std::string_view bytes, std::size_t index) {
  Unsigned value = 0;
  for (std::size_t i = 0; i < sizeof(Unsigned); ++i) {
    value = static_cast<Unsigned>((value << 8U) | byte_at(bytes, index + i));
  }
  return value;
}

double float_at(std::string_view bytes, std::size_t index) {
  return static_cast<double>(std::bit_cast<float>(big_endian<std::uint32_t>(bytes, index)));
}

template <typename Unsigned>
std::string to_big_endian(Unsigned value) {
  std::string bytes;
  for (std::size_t i = sizeof(Unsigned); i-- > 0;) bytes += static_cast<char>((value >> (8U * i)) & 0xFFU);
  return bytes;
}

std::string with_entries(std::string data, const std::vector<FormatEntry>& entries) {
  if (entries.size() > 255) throw std::invalid_argument("a MIP message format has at most 255 entries");
  data.push_back(static_cast<char>(entries.size()));
  for (const FormatEntry& entry : entries) {
    data.push_back(static_cast<char>(entry.descriptor));
    data.append(u16(entry.decimation));
  }
  return data;
}

// Padded with spaces according to the manual; zeros are seen too.
constexpr std::string_view kPadding(" \0", 2);

}  // namespace

std::uint16_t checksum(std::string_view bytes) {
  unsigned a = 0;
  unsigned b = 0;
  for (const char byte : bytes) {
    a = (a + static_cast<std::uint8_t>(byte)) & 0xFFU;
    b = (b + a) & 0xFFU;
  }
  return static_cast<std::uint16_t>(a << 8U | b);
}

std::string u8(std::uint8_t value) {
  return std::string(1, static_cast<char>(value));
}
std::string u16(std::uint16_t value) {
  return to_big_endian(value);
}
std::string u32(std::uint32_t value) {
  return to_big_endian(value);
}

std::string make_field(std::uint8_t descriptor, std::string_view data) {
  if (data.size() > kMaxPayload - 2) {
    throw std::invalid_argument("MIP field data of " + std::to_string(data.size()) +
                                " bytes; at most 253 fit");
  }
  std::string field;
  field.push_back(static_cast<char>(data.size() + 2));
  field.push_back(static_cast<char>(descriptor));
  field.append(data);
  return field;
}

std::string make_packet(std::uint8_t descriptor_set, std::initializer_list<std::string_view> fields) {
  std::string payload;
  for (const std::string_view field : fields) payload += field;
  if (payload.size() > kMaxPayload) {
    throw std::invalid_argument("MIP payload of " + std::to_string(payload.size()) +
                                " bytes; at most 255 fit");
  }
  std::string packet{kSync1, kSync2, static_cast<char>(descriptor_set), static_cast<char>(payload.size())};
  packet.append(payload);
  packet.append(u16(checksum(packet)));
  return packet;
}

std::string legacy_message_format(const std::vector<FormatEntry>& entries) {
  return with_entries(u8(kWrite), entries);
}

std::string message_format(std::uint8_t data_set, const std::vector<FormatEntry>& entries) {
  std::string data = u8(kWrite);
  data.append(u8(data_set));
  return with_entries(std::move(data), entries);
}

constexpr auto kAckCodes = names<std::uint8_t>({{0, "done"},
                                                {1, "unknown command"},
                                                {2, "checksum of the command was wrong"},
                                                {3, "parameter not valid"},
                                                {4, "command failed"},
                                                {5, "the device timed out"}});

std::string_view ack_code_in_words(std::uint8_t code) {
  return kAckCodes.of(code, "no meaning known");
}

std::optional<std::vector<Field>> split_fields(std::string_view payload) {
  std::vector<Field> fields;
  fields.reserve(kUsualFields);
  while (!payload.empty()) {
    const std::size_t length = byte_at(payload, 0);
    if (length < 2 || length > payload.size()) return std::nullopt;
    fields.push_back({byte_at(payload, 1), payload.substr(2, length - 2)});
    payload.remove_prefix(length);
  }
  return fields;
}

void PacketParser::feed(std::string_view bytes) {
  buffer_.erase(0, begin_);
  begin_ = 0;
  buffer_ += bytes;
}

PacketParser::Found PacketParser::look_at(std::size_t position) const {
  const std::string_view here = std::string_view(buffer_).substr(position);
  if (here[0] != kSync1) return Found::kNothingHere;
  if (here.size() < 2) return Found::kNeedsMore;
  if (here[1] != kSync2) return Found::kNothingHere;
  if (here.size() < kHeader) return Found::kNeedsMore;
  const std::size_t body = kHeader + byte_at(here, 3);
  if (here.size() < body + kChecksum) return Found::kNeedsMore;
  return checksum(here.substr(0, body)) == big_endian<std::uint16_t>(here, body) ? Found::kPacket
                                                                                 : Found::kBadChecksum;
}

Packet PacketParser::take(std::size_t position) {
  const std::size_t length = byte_at(buffer_, position + 3);
  begin_ = position + kPacketOverhead + length;
  return {byte_at(buffer_, position + 2), std::string_view(buffer_).substr(position + kHeader, length)};
}

std::optional<Packet> PacketParser::next() {
  for (; begin_ < buffer_.size(); ++begin_, ++skipped_bytes_) {
    switch (look_at(begin_)) {
      case Found::kPacket:
        return take(begin_);
      case Found::kNeedsMore:
        return std::nullopt;
      case Found::kBadChecksum:
        ++bad_frames_;
        break;
      case Found::kNothingHere:
        break;
    }
  }
  return std::nullopt;
}

std::optional<Packet> PacketParser::next_behind_partial() {
  for (std::size_t position = begin_; position < buffer_.size(); ++position) {
    if (look_at(position) != Found::kPacket) continue;
    skipped_bytes_ += position - begin_;
    return take(position);
  }
  return std::nullopt;
}

std::optional<Eigen::Vector3d> decode_scaled_accelerometer(std::string_view data) {
  if (data.size() != 12) return std::nullopt;
  return Eigen::Vector3d(float_at(data, 0), float_at(data, 4), float_at(data, 8));
}

std::optional<Temperature> decode_temperature(std::string_view data) {
  if (data.size() != 12) return std::nullopt;
  return Temperature{float_at(data, 0), float_at(data, 4), float_at(data, 8)};
}

std::optional<GpsTimestamp> decode_gps_timestamp(std::string_view data) {
  if (data.size() != 12) return std::nullopt;
  return GpsTimestamp{std::bit_cast<double>(big_endian<std::uint64_t>(data, 0)),
                      big_endian<std::uint16_t>(data, 8), big_endian<std::uint16_t>(data, 10)};
}

std::optional<std::uint16_t> decode_over_range(std::string_view data) {
  return decode_u16(data);
}

std::optional<std::uint64_t> decode_reference_time(std::string_view data) {
  if (data.size() != 8) return std::nullopt;
  return big_endian<std::uint64_t>(data, 0);
}

std::optional<DeviceInfo> decode_device_info(std::string_view data) {
  constexpr std::size_t kText = 16;
  if (data.size() != 2 + 5 * kText) return std::nullopt;
  const auto text = [&](std::size_t index) {
    return std::string(pieces::trimmed(data.substr(2 + index * kText, kText), kPadding));
  };
  return DeviceInfo{big_endian<std::uint16_t>(data, 0), text(0), text(1), text(2), text(3), text(4)};
}

std::optional<std::vector<std::uint16_t>> decode_descriptors(std::string_view data) {
  if (data.size() % 2 != 0) return std::nullopt;
  std::vector<std::uint16_t> descriptors;
  for (std::size_t i = 0; i < data.size(); i += 2) descriptors.push_back(big_endian<std::uint16_t>(data, i));
  return descriptors;
}

std::optional<Acknowledgement> decode_acknowledgement(std::string_view data) {
  if (data.size() != 2) return std::nullopt;
  return Acknowledgement{byte_at(data, 0), byte_at(data, 1)};
}

std::optional<std::uint16_t> decode_u16(std::string_view data) {
  if (data.size() != 2) return std::nullopt;
  return big_endian<std::uint16_t>(data, 0);
}

}  // namespace abcal::mip
