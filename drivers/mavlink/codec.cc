#include "drivers/mavlink/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <utility>

namespace abcal::mavlink {
namespace {

constexpr std::uint8_t kMagic1 = 0xFE;
constexpr std::uint8_t kMagic2 = 0xFD;
constexpr std::size_t kHeader1 = 6;
constexpr std::size_t kHeader2 = 10;
constexpr std::size_t kCrcSize = 2;
constexpr std::size_t kSignatureSize = 13;
constexpr std::uint8_t kSigned = 0x01;
constexpr double kStandardGravity = 9.80665;
constexpr std::size_t kBufferKept = 4096;

// Seeds and lengths are those of the message definitions (common.xml, minimal.xml).
constexpr std::array kKinds = std::to_array<MessageKind>({{kHeartbeat, 50, 9, 9},
                                                          {1, 124, 31, 43},  // SYS_STATUS
                                                          {2, 137, 12, 12},  // SYSTEM_TIME
                                                          {kParamRequestRead, 214, 20, 20},
                                                          {kParamValue, 220, 25, 25},
                                                          {kParamSet, 168, 23, 23},
                                                          {kScaledImu, 170, 22, 24},
                                                          {27, 144, 26, 29},  // RAW_IMU
                                                          {30, 39, 28, 28},   // ATTITUDE
                                                          {kCommandLong, 152, 33, 33},
                                                          {kCommandAck, 143, 3, 10},
                                                          {kHighresImu, 93, 62, 63},
                                                          {116, 76, 22, 24},  // SCALED_IMU2
                                                          {129, 46, 22, 24},  // SCALED_IMU3
                                                          {kAutopilotVersion, 178, 60, 78}});

std::uint8_t byte_at(std::string_view bytes, std::size_t at) {
  return static_cast<std::uint8_t>(bytes[at]);
}

template <class T>
T read(std::string_view bytes, std::size_t at) {
  static_assert(std::endian::native == std::endian::little);
  T value{};
  std::memcpy(&value, bytes.data() + at, sizeof value);
  return value;
}

template <class T>
void append(std::string& bytes, T value) {
  std::array<char, sizeof(T)> raw{};
  std::memcpy(raw.data(), &value, sizeof value);
  bytes.append(raw.data(), raw.size());
}

/// Fields of a frame known from its first bytes, as far as they have arrived.
struct Header {
  std::size_t size = 0;  ///< Size of the whole frame; 0: more bytes are needed to know.
  std::size_t header = 0;
  std::size_t payload = 0;
  std::uint32_t id = 0;
  bool understood = true;  ///< No flag that forbids reading it.
};

/// Absent: no frame begins here.
std::optional<Header> read_header(std::string_view bytes) {
  const std::uint8_t magic = byte_at(bytes, 0);
  if (magic != kMagic1 && magic != kMagic2) return std::nullopt;
  Header header;
  header.header = magic == kMagic1 ? kHeader1 : kHeader2;
  if (bytes.size() < header.header) return header;
  header.payload = byte_at(bytes, 1);
  header.size = header.header + header.payload + kCrcSize;
  if (magic == kMagic1) {
    header.id = byte_at(bytes, 5);
    return header;
  }
  const std::uint8_t flags = byte_at(bytes, 2);
  header.understood = (flags & ~kSigned) == 0;
  if ((flags & kSigned) != 0) header.size += kSignatureSize;
  header.id = byte_at(bytes, 7) | static_cast<std::uint32_t>(byte_at(bytes, 8)) << 8U |
              static_cast<std::uint32_t>(byte_at(bytes, 9)) << 16U;
  return header;
}

Frame make_frame_of(std::string_view bytes, const Header& header) {
  const bool first = header.header == kHeader1;
  const std::size_t at = first ? 2 : 4;
  Frame frame;
  frame.version = first ? 1 : 2;
  frame.sequence = byte_at(bytes, at);
  frame.system = byte_at(bytes, at + 1);
  frame.component = byte_at(bytes, at + 2);
  frame.id = header.id;
  frame.payload = bytes.substr(header.header, header.payload);
  frame.size = header.size;
  return frame;
}

/// Whether the length is one of its kind: version 2 cuts zeros off, and a newer sender may append fields;
/// version 1 does neither.
bool can_be(const Header& header, const MessageKind& kind) {
  return header.header == kHeader2 ||
         (header.payload >= kind.base_length && header.payload <= kind.full_length);
}

/// Whether its checksum is right.
bool is_sound(std::string_view bytes, const Header& header, const MessageKind& kind) {
  const std::size_t end = header.header + header.payload;
  return checksum(bytes.substr(1, end - 1), kind.crc_extra) == read<std::uint16_t>(bytes, end);
}

}  // namespace

std::optional<MessageKind> find_kind(std::uint32_t id) {
  for (const MessageKind& kind : kKinds)
    if (kind.id == id) return kind;
  return std::nullopt;
}

std::uint16_t checksum(std::string_view bytes, std::uint8_t crc_extra) {
  unsigned crc = 0xFFFF;
  const auto add = [&crc](std::uint8_t byte) {
    unsigned mixed = (byte ^ crc) & 0xFFU;
    mixed = (mixed ^ mixed << 4U) & 0xFFU;
    crc = (crc >> 8U ^ mixed << 8U ^ mixed << 3U ^ mixed >> 4U) & 0xFFFFU;
  };
  for (const char c : bytes) add(static_cast<std::uint8_t>(c));
  add(crc_extra);
  return static_cast<std::uint16_t>(crc);
}

// Frames.

void FrameParser::feed(std::string_view bytes) {
  if (begin_ > kBufferKept) {
    buffer_.erase(0, begin_);
    begin_ = 0;
  }
  buffer_ += bytes;
}

void FrameParser::skip_one() {
  ++begin_;
  ++skipped_bytes_;
  in_step_ = false;
}

void FrameParser::lose_track() {
  skipped_bytes_ += buffer_.size() - begin_;
  buffer_.clear();
  begin_ = 0;
  in_step_ = false;
}

std::optional<Frame> FrameParser::next() {
  while (begin_ < buffer_.size()) {
    const std::string_view rest = std::string_view(buffer_).substr(begin_);
    const auto header = read_header(rest);
    if (!header) {
      skip_one();
      continue;
    }
    if (header->size == 0) return std::nullopt;
    const auto kind = find_kind(header->id);
    const bool readable = kind && header->understood;
    if ((!readable && !in_step_) || (readable && !can_be(*header, *kind))) {
      skip_one();
      continue;
    }
    if (rest.size() < header->size) return std::nullopt;
    if (readable && !is_sound(rest, *header, *kind)) {
      ++bad_frames_;
      skip_one();
      continue;
    }
    Frame frame = make_frame_of(rest, *header);
    frame.known = readable;
    if (readable && frame.payload.size() < kind->full_length) frame.payload.resize(kind->full_length, '\0');
    begin_ += header->size;
    in_step_ = true;
    return frame;
  }
  return std::nullopt;
}

std::optional<Frame> FrameParser::next_behind_partial() {
  while (has_partial()) {
    if (auto frame = next()) return frame;
    if (has_partial()) skip_one();
  }
  return std::nullopt;
}

// Messages.

bool Heartbeat::is_vehicle() const {
  constexpr std::uint8_t kNoAutopilot = 8;
  constexpr std::uint8_t kGroundStation = 6;
  return autopilot != kNoAutopilot && type != kGroundStation;
}

std::optional<Heartbeat> decode_heartbeat(const Frame& frame) {
  if (!frame.known || frame.id != kHeartbeat) return std::nullopt;
  return Heartbeat{byte_at(frame.payload, 4), byte_at(frame.payload, 5), byte_at(frame.payload, 6)};
}

std::string autopilot_name(std::uint8_t autopilot) {
  if (autopilot == kArduPilot) return "ArduPilot";
  if (autopilot == kPx4) return "PX4";
  return autopilot == 0 ? "MAVLink autopilot" : fmt::format("MAVLink autopilot {}", autopilot);
}

namespace {

std::optional<Acceleration> decode_highres(const Frame& frame) {
  constexpr unsigned kAccelerationUpdated = 0x0007;
  constexpr unsigned kTemperatureUpdated = 0x1000;
  const auto updated = read<std::uint16_t>(frame.payload, 60);
  if ((updated & kAccelerationUpdated) != kAccelerationUpdated) return std::nullopt;
  Acceleration acceleration;
  acceleration.time_us = read<std::uint64_t>(frame.payload, 0);
  for (int j = 0; j < 3; ++j)
    acceleration.output_mps2[j] =
        static_cast<double>(read<float>(frame.payload, 8 + 4 * static_cast<std::size_t>(j)));
  if (const auto temperature = static_cast<double>(read<float>(frame.payload, 56));
      (updated & kTemperatureUpdated) != 0 && std::isfinite(temperature))
    acceleration.temperature_degc = temperature;
  return acceleration;
}

std::optional<Acceleration> decode_scaled(const Frame& frame) {
  constexpr std::uint64_t kMilliseconds32 = 4294967296ULL * 1000;
  Acceleration acceleration;
  acceleration.time_us = std::uint64_t{read<std::uint32_t>(frame.payload, 0)} * 1000;
  acceleration.time_span_us = kMilliseconds32;
  for (int j = 0; j < 3; ++j) {
    const auto word = read<std::int16_t>(frame.payload, 4 + 2 * static_cast<std::size_t>(j));
    acceleration.output_mps2[j] = word * kStandardGravity / 1000.0;
    if (word == 32767 || word == -32768) acceleration.clipped = true;
  }
  if (const auto temperature = read<std::int16_t>(frame.payload, 22); temperature != 0)
    acceleration.temperature_degc = temperature / 100.0;
  return acceleration;
}

}  // namespace

std::optional<Acceleration> decode_acceleration(const Frame& frame) {
  if (!frame.known) return std::nullopt;
  std::optional<Acceleration> acceleration;
  if (frame.id == kHighresImu) acceleration = decode_highres(frame);
  if (frame.id == kScaledImu) acceleration = decode_scaled(frame);
  return acceleration;
}

std::optional<Version> decode_version(const Frame& frame) {
  if (!frame.known || frame.id != kAutopilotVersion) return std::nullopt;
  Version version;
  // 18 bytes, of newer senders; else 8.
  std::string identity = frame.payload.substr(60, 18);
  const auto all_zero = [](std::string_view bytes) {
    return std::all_of(bytes.begin(), bytes.end(), [](char c) { return c == '\0'; });
  };
  if (all_zero(identity)) {
    const auto number = read<std::uint64_t>(frame.payload, 8);
    if (number != 0) version.serial_number = fmt::format("{:016X}", number);
  } else {
    for (const char c : identity)
      version.serial_number += fmt::format("{:02X}", static_cast<std::uint8_t>(c));
  }
  const auto software = read<std::uint32_t>(frame.payload, 16);
  version.firmware =
      fmt::format("{}.{}.{}", software >> 24U, software >> 16U & 0xFFU, software >> 8U & 0xFFU);
  return version;
}

std::optional<Parameter> decode_parameter(const Frame& frame, std::uint8_t autopilot) {
  constexpr std::size_t kNameAt = 8;
  constexpr std::size_t kTypeAt = 24;
  constexpr std::uint8_t kUint32 = 5;
  constexpr std::uint8_t kFloat = 9;
  if (!frame.known || frame.id != kParamValue) return std::nullopt;
  Parameter parameter;
  parameter.name = frame.payload.substr(kNameAt, kTypeAt - kNameAt);
  parameter.name.resize(std::min(parameter.name.find('\0'), parameter.name.size()));
  parameter.type = byte_at(frame.payload, kTypeAt);
  if (parameter.type < kFloat && autopilot != kArduPilot) {
    parameter.value = parameter.type == kUint32 ? static_cast<double>(read<std::uint32_t>(frame.payload, 0))
                                                : static_cast<double>(read<std::int32_t>(frame.payload, 0));
  } else {
    parameter.value = static_cast<double>(read<float>(frame.payload, 0));
  }
  return parameter;
}

std::optional<Acknowledgement> decode_acknowledgement(const Frame& frame) {
  if (!frame.known || frame.id != kCommandAck) return std::nullopt;
  return Acknowledgement{read<std::uint16_t>(frame.payload, 0), byte_at(frame.payload, 2)};
}

std::string_view result_in_words(unsigned result) {
  constexpr std::array<std::string_view, 7> kResults{
      "accepted", "not now; try again", "denied", "not supported", "failed", "in progress", "cancelled"};
  return result < kResults.size() ? kResults[result] : "of unknown meaning";
}

std::string make_frame(int version, std::uint8_t sequence, std::uint32_t id, std::string_view payload) {
  const auto kind = find_kind(id);
  if (!kind || payload.size() < kind->base_length || payload.size() > kind->full_length)
    throw std::invalid_argument(
        fmt::format("MAVLink message {} with {} bytes: no such message", id, payload.size()));
  if (version == 1) payload = payload.substr(0, kind->base_length);
  if (version == 2)
    while (payload.size() > 1 && payload.back() == '\0') payload.remove_suffix(1);
  std::string frame;
  append(frame, version == 1 ? kMagic1 : kMagic2);
  append(frame, static_cast<std::uint8_t>(payload.size()));
  if (version == 2) append(frame, std::uint16_t{0});
  append(frame, sequence);
  append(frame, kOurSystem);
  append(frame, kOurComponent);
  append(frame, static_cast<std::uint8_t>(id));
  if (version == 2) append(frame, static_cast<std::uint16_t>(id >> 8U));
  frame += payload;
  append(frame, checksum(std::string_view(frame).substr(1), kind->crc_extra));
  return frame;
}

std::string command_long(std::uint8_t system, std::uint8_t component, std::uint16_t command,
                         const std::array<float, 2>& parameters) {
  std::string payload;
  for (const float parameter : parameters) append(payload, parameter);
  for (int n = 0; n < 5; ++n) append(payload, 0.0F);
  append(payload, command);
  append(payload, system);
  append(payload, component);
  append(payload, std::uint8_t{0});
  return make_frame(2, 0, kCommandLong, payload);
}

namespace {

/// Filled up with zeros. @throws std::invalid_argument if it is too long
std::string parameter_name(std::string_view name) {
  constexpr std::size_t kLongest = 16;
  if (name.empty() || name.size() > kLongest)
    throw std::invalid_argument(fmt::format("MAVLink parameter \"{}\": required: 1 to 16 characters", name));
  std::string padded(name);
  padded.resize(kLongest, '\0');
  return padded;
}

}  // namespace

std::string param_request_read(std::uint8_t system, std::uint8_t component, std::string_view name) {
  std::string payload;
  append(payload, std::int16_t{-1});  // The parameter is requested by name.
  append(payload, system);
  append(payload, component);
  return make_frame(2, 0, kParamRequestRead, payload + parameter_name(name));
}

std::string param_set(std::uint8_t system, std::uint8_t component, std::string_view name, float value) {
  constexpr std::uint8_t kFloat = 9;
  std::string payload;
  append(payload, value);
  append(payload, system);
  append(payload, component);
  payload += parameter_name(name);
  append(payload, kFloat);
  return make_frame(2, 0, kParamSet, payload);
}

std::string our_heartbeat() {
  constexpr std::uint8_t kGroundStation = 6;
  constexpr std::uint8_t kNoAutopilot = 8;
  constexpr std::uint8_t kActive = 4;
  constexpr std::uint8_t kProtocol = 3;
  std::string payload;
  append(payload, std::uint32_t{0});
  for (const std::uint8_t byte : {kGroundStation, kNoAutopilot, std::uint8_t{0}, kActive, kProtocol})
    append(payload, byte);
  return make_frame(2, 0, kHeartbeat, payload);
}

}  // namespace abcal::mavlink
