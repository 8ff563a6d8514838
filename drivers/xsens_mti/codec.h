#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// Xbus, the low-level wire format of Xsens (Movella) MTi sensors ("MT Low-Level Communication Protocol"):
/// bytes to messages and back. Pure: no port, no clock, no logging.
///
/// A message is FA FF, message id, length, data, checksum. A length of FF means that two bytes with the real
/// length follow. All numbers are big-endian.
namespace abcal::xbus {

inline constexpr std::size_t kMaxData = 2048;  ///< [unverified against a device] Longest data of a message.

/// Message ids. The answer to a command has its id + 1.
enum MessageId : std::uint8_t {
  kReqDeviceId = 0x00,
  kGotoMeasurement = 0x10,
  kReqFirmware = 0x12,
  kReqProductCode = 0x1C,
  kReqHardware = 0x1E,
  kGotoConfig = 0x30,
  kMtData2 = 0x36,
  kWakeUp = 0x3E,
  kError = 0x42,
  kSetOutputConfiguration = 0xC0,
};

/// Data ids without their lowest four bits, which give the number format and the frame.
enum DataId : std::uint16_t {
  kTemperature = 0x0810,
  kPacketCounter = 0x1020,
  kSampleTimeFine = 0x1060,
  kAcceleration = 0x4020,
  kStatusWord = 0xE020,
};
constexpr std::uint16_t kind_of(std::uint16_t id) {
  return static_cast<std::uint16_t>(id & 0xFFF0U);
}

/// The byte that makes the sum of `bytes` (all behind FA) and itself 0 modulo 256.
std::uint8_t checksum(std::string_view bytes);

/// A whole message. @throws std::invalid_argument if data is longer than kMaxData.
std::string make_message(std::uint8_t id, std::string_view data = {});

/// A message whose checksum was right; `data` points into the parser until its next call.
struct Message {
  std::uint8_t id = 0;
  std::string_view data;
};
inline constexpr std::size_t kFrameBytes = 5;  ///< FA FF, id, length, checksum.
/// Bytes of a message on the wire.
inline std::size_t wire_size(const Message& message) {
  return message.data.size() + kFrameBytes;
}

/// One item of an MTData2 message; `data` points into the message.
struct Item {
  std::uint16_t id = 0;
  std::string_view data;
};

/// The items of MTData2, or nullopt if their lengths do not fill it exactly.
std::optional<std::vector<Item>> split_items(std::string_view data);

/// Finds messages in a stream of bytes that may begin anywhere, be split anywhere, and be damaged.
///
/// From each byte on: if a message with a right checksum begins here it is given and the search goes on
/// behind it, else at the next byte. MTData2 must also be filled by its items: the sum of 8 bits would let a
/// damaged length pass once in 256. The result does not depend on how the bytes were split.
class MessageParser {
 public:
  void feed(std::string_view bytes);

  /// The next message in the bytes fed so far; absent if it needs more bytes.
  std::optional<Message> next();

  /// The next whole message *after* an incomplete one, for a line that has become silent: a false beginning
  /// may claim bytes that never arrive.
  std::optional<Message> next_behind_partial();

  /// True if bytes are held back that may begin a message.
  bool has_partial() const { return begin_ < buffer_.size(); }

  /// Something that was framed like a message and had a wrong checksum or impossible items.
  std::uint64_t bad_frames() const { return bad_frames_; }
  /// Bytes that belong to no message, those of bad ones included.
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  enum class Found { kNothingHere, kBad, kNeedsMore, kMessage };
  struct Look {
    Found found = Found::kNothingHere;
    Message message = {};
    std::size_t size = 0;  ///< Bytes of the message with its frame.
  };
  Look look_at(std::size_t position) const;

  std::string buffer_;
  std::size_t begin_ = 0;  ///< Bytes before this position are consumed.
  std::uint64_t bad_frames_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

// Items as values. Nullopt if the data does not have exactly the length that its id requires.

/// Real numbers in the format given by the lowest two bits of the id: 0 float32; 1 FP12.20: int32 / 2^20; 2
/// FP16.32: 4 bytes of fraction, then 2 of integer, value = integer + fraction / 2^32; 3 float64.
std::optional<std::vector<double>> decode_reals(std::uint16_t id, std::string_view data, std::size_t count);

/// 4020: acceleration (specific force) along the sensor's x, y, z, m/s2. The reaction, not the pull: an axis
/// that points up reads about +9.8 at rest.
std::optional<Eigen::Vector3d> decode_acceleration(const Item& item);
/// 0810, degrees Celsius.
std::optional<double> decode_temperature(const Item& item);

/// Big-endian numbers of exactly two or four bytes.
std::optional<std::uint16_t> decode_u16(std::string_view data);
std::optional<std::uint32_t> decode_u32(std::string_view data);

/// E020: an accelerometer has clipped. Bits 8, 9, 10 are those of accelerometer x, y, z; 11 to 16 of
/// gyroscope and magnetometer; 19 means that any of them clipped, and counts here only if no other bit is set
/// [unverified against a device].
constexpr bool accelerometer_clipped(std::uint32_t status_word) {
  constexpr std::uint32_t kAccelerometer = 0x0000'0700U;
  constexpr std::uint32_t kOthers = 0x0001'F800U;
  constexpr std::uint32_t kAny = 0x0008'0000U;
  return (status_word & kAccelerometer) != 0 || ((status_word & kAny) != 0 && (status_word & kOthers) == 0);
}

/// One entry of the output configuration (C0, C1).
struct Output {
  std::uint16_t id = 0;
  std::uint16_t rate_hz = 0;  ///< FFFF: in every packet.
};
inline constexpr std::uint16_t kEveryPacket = 0xFFFF;
std::string output_configuration(const std::vector<Output>& outputs);
/// Nullopt if the length is not a multiple of four.
std::optional<std::vector<Output>> decode_output_configuration(std::string_view data);

/// The meaning of the code of an error message (42).
std::string_view error_in_words(unsigned code);

}  // namespace abcal::xbus
