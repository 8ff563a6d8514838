#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// The MIP wire format of MicroStrain inertial sensors (MIP protocol, "Data Communications Protocol" of each
/// model): bytes to packets and back. Pure: no port, no clock, no logging.
///
/// A packet is 75 65, descriptor set, payload length, payload, checksum (2 bytes). Its payload is a row of
/// fields: length (counting itself and the descriptor), descriptor, data. All numbers are big-endian.
namespace abcal::mip {

inline constexpr std::size_t kMaxPayload = 255;
inline constexpr std::size_t kPacketOverhead = 6;  ///< Sync 2, set 1, length 1, checksum 2.
inline constexpr std::size_t kMaxPacket = kMaxPayload + kPacketOverhead;

/// Descriptor sets.
enum : std::uint8_t {
  kBaseSet = 0x01,
  k3dmSet = 0x0C,
  kSensorSet = 0x80,
  kFilterSet = 0x82,
  kSystemSet = 0xA0
};

/// Field of every answer to a command: {descriptor of the command, code}.
inline constexpr std::uint8_t kAckField = 0xF1;

/// Fields of the sensor data set 0x80; those from 0xD3 on are shared by all data sets.
enum : std::uint8_t {
  kScaledAccelerometer = 0x04,
  kGpsTimestamp = 0x12,
  kTemperature = 0x14,
  kOverRange = 0x18,
  kReferenceTime = 0xD5,
};

/// Fletcher sum over `bytes` (all of a packet before its checksum): a += byte, b += a, both modulo 256; a <<
/// 8 | b.
std::uint16_t checksum(std::string_view bytes);

/// Big-endian bytes of a number, for the data of a field.
std::string u8(std::uint8_t value);
std::string u16(std::uint16_t value);
std::string u32(std::uint32_t value);

/// One field with its length byte. @throws std::invalid_argument if data is longer than 253 bytes.
std::string make_field(std::uint8_t descriptor, std::string_view data = {});

/// A whole packet of the given fields (made by make_field).
/// @throws std::invalid_argument if they are longer than 255 bytes together.
std::string make_packet(std::uint8_t descriptor_set, std::initializer_list<std::string_view> fields);

/// One field of a data set with its decimation, as the message-format commands want it.
struct FormatEntry {
  std::uint8_t descriptor = 0;
  std::uint16_t decimation = 1;
};

/// 0C,08: the message format of the inertial stream of older models (function 1: write).
std::string legacy_message_format(const std::vector<FormatEntry>& entries);
/// 0C,0F: the message format of any data set (function 1: write).
std::string message_format(std::uint8_t data_set, const std::vector<FormatEntry>& entries);

/// The meaning of the code in an acknowledgement: "unknown command" for 1, and so on; "code 23" if there is
/// none.
std::string_view ack_code_in_words(std::uint8_t code);

/// One field of a packet; `data` points into the packet's payload.
struct Field {
  std::uint8_t descriptor = 0;
  std::string_view data;  ///< Without length and descriptor.
};

/// The fields of a payload, or nullopt if a length byte is below 2 or points beyond the end.
std::optional<std::vector<Field>> split_fields(std::string_view payload);

/// A packet whose checksum was right; `payload` points into the parser until its next call.
struct Packet {
  std::uint8_t descriptor_set = 0;
  std::string_view payload;
};
/// Bytes of a packet on the wire.
inline std::size_t wire_size(const Packet& packet) {
  return packet.payload.size() + kPacketOverhead;
}

/// Finds packets in a stream of bytes that may begin anywhere, be split anywhere, and be damaged.
///
/// From each byte on: if a packet with a right checksum begins here it is given and the search goes on behind
/// it, else at the next byte. So a false sync (75 65 in the midst of data) costs no packet behind it, and the
/// result does not depend on how the bytes were split.
class PacketParser {
 public:
  void feed(std::string_view bytes);

  /// The next packet in the bytes fed so far; absent if it needs more bytes.
  std::optional<Packet> next();

  /// The next whole packet *after* an incomplete one, for a stream that has become silent: a false sync may
  /// claim 255 bytes that never arrive, with a good answer among those that have arrived.
  std::optional<Packet> next_behind_partial();

  /// True if bytes are held back that may begin a packet.
  bool has_partial() const { return begin_ < buffer_.size(); }

  /// Something that looked like a packet and had a wrong checksum.
  std::uint64_t bad_frames() const { return bad_frames_; }
  /// Bytes that belong to no packet, those of packets with a wrong checksum included.
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  enum class Found { kNothingHere, kBadChecksum, kNeedsMore, kPacket };
  Found look_at(std::size_t position) const;
  Packet take(std::size_t position);

  std::string buffer_;
  std::size_t begin_ = 0;  ///< Bytes before this position are consumed.
  std::uint64_t bad_frames_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

// Field data as values. Nullopt if the data does not have exactly the length of the field.

/// 80,04: acceleration (specific force) along the sensor's x, y, z, in g. The reaction, not the pull: an axis
/// that points up reads +1 at rest, so a device lying with its z axis down reads about -1 on z.
std::optional<Eigen::Vector3d> decode_scaled_accelerometer(std::string_view data);

/// 80,14: degrees Celsius. Statistics since the device was switched on or reset (mip_sdk, data_sensor.h), so
/// the mean follows the present temperature slowly.
struct Temperature {
  double min_degc = 0.0;
  double max_degc = 0.0;
  double mean_degc = 0.0;
};
std::optional<Temperature> decode_temperature(std::string_view data);

/// 80,12: GPS time as the device keeps it. It may step when a receiver or a PPS signal corrects it; bit 1 of
/// `flags` toggles then (mip_sdk, data_sensor.h).
struct GpsTimestamp {
  double time_of_week_s = 0.0;
  std::uint16_t week = 0;
  std::uint16_t flags = 0;
};
std::optional<GpsTimestamp> decode_gps_timestamp(std::string_view data);

/// 80,18: bit 0 accelerometer x, 1 y, 2 z; the others are of the gyroscope, magnetometer and barometer.
std::optional<std::uint16_t> decode_over_range(std::string_view data);
constexpr bool accelerometer_over_range(std::uint16_t status) {
  return (status & 0x0007U) != 0;
}

/// D5: time since the device started, nanoseconds.
std::optional<std::uint64_t> decode_reference_time(std::string_view data);

/// 01,81: the device's own description. Strings without the spaces that pad them.
struct DeviceInfo {
  std::uint16_t firmware = 0;
  std::string model_name;
  std::string model_number;
  std::string serial_number;
  std::string lot_number;
  std::string options;
};
std::optional<DeviceInfo> decode_device_info(std::string_view data);

/// 01,82: commands and data fields that the device offers, each descriptor set << 8 | field descriptor.
std::optional<std::vector<std::uint16_t>> decode_descriptors(std::string_view data);

/// F1.
struct Acknowledgement {
  std::uint8_t command = 0;  ///< Descriptor of the command that is answered.
  std::uint8_t code = 0;     ///< 0: done.
};
std::optional<Acknowledgement> decode_acknowledgement(std::string_view data);

/// A big-endian u16 of two bytes exactly.
std::optional<std::uint16_t> decode_u16(std::string_view data);

}  // namespace abcal::mip
