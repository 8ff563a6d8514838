#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

/// The wire format of VectorNav sensors (VN-100 User Manual, "Communication Interface"): bytes to messages
/// and back. Pure: no port, no clock, no logging.
///
/// Text messages are '$', text, '*', checksum, CR LF; binary ones are FA, a byte of groups, a 16-bit field
/// mask for each group, the fields (little-endian), and a CRC. Both are mixed on one line.
namespace abcal::vectornav {

/// The two checksums of text messages. A device answers with the kind with which it was asked.
enum class Checksum { kXor8, kCrc16 };

/// XOR of all characters between '$' and '*'.
std::uint8_t xor8(std::string_view text);
/// CRC-16-CCITT as the manual gives it (polynomial 1021, start 0). Over a message and its CRC it is 0.
std::uint16_t crc16(std::string_view bytes);

/// A whole text message: '$' + text + '*' + checksum + CR LF.
std::string make_message(std::string_view text, Checksum checksum);

/// A text message whose checksum was right; `text` is the part between '$' and '*'.
struct TextMessage {
  std::string_view text;
  Checksum checksum = Checksum::kXor8;
  bool carriage_return = true;  ///< Before the line feed; some programs that pass a stream on drop it.
};

inline constexpr std::size_t kGroups = 6;

/// Groups of a binary message; the numbers are bits of its groups byte.
enum Group : std::uint8_t { kCommon = 0, kTime = 1, kImu = 2, kGnss = 3, kAttitude = 4, kIns = 5 };

/// Fields by their bit in the mask of their group.
enum CommonField : std::uint8_t { kTimeStartup = 0, kAcceleration = 8, kMagneticTemperaturePressure = 10 };
enum ImuField : std::uint8_t { kTemperature = 4, kImuAcceleration = 9 };

/// A binary message whose CRC was right.
struct BinaryMessage {
  std::array<std::uint16_t, kGroups> fields{};  ///< Mask by group; 0: the group is absent.
  std::string_view payload;                     ///< The fields, without header and CRC.
};

/// Views point into the parser until its next call.
using Message = std::variant<TextMessage, BinaryMessage>;

/// The header of a binary message with these field masks: FA, groups, masks.
std::string binary_header(const std::array<std::uint16_t, kGroups>& fields);
/// Bytes of a message with these fields, header and CRC; absent if a mask has a field whose length is not
/// known.
std::optional<std::size_t> binary_size(const std::array<std::uint16_t, kGroups>& fields);

/// Bytes of a message on the wire.
std::size_t wire_size(const Message& message);

/// Finds messages in a stream of bytes that may begin anywhere, be split anywhere, and be damaged.
///
/// From each byte on: if a whole message with a right checksum begins here it is given and the search goes on
/// behind it, else at the next byte. The result does not depend on how the bytes were split.
class MessageParser {
 public:
  /// `only_header`: binary messages with another header than this (see binary_header()) are no messages. With
  /// it a damaged header is noticed at once and cannot be taken for one of another length. Empty: any.
  explicit MessageParser(std::string only_header = {}) : only_header_(std::move(only_header)) {}

  void feed(std::string_view bytes);

  /// The next message in the bytes fed so far; absent if it needs more bytes.
  std::optional<Message> next();

  /// The next whole message *after* an incomplete one, for a line that has become silent: a false beginning
  /// may claim bytes that never arrive.
  std::optional<Message> next_behind_partial();

  /// True if bytes are held back that may begin a message.
  bool has_partial() const { return begin_ < buffer_.size(); }

  /// Something that was framed like a message and had a wrong checksum.
  std::uint64_t bad_frames() const { return bad_frames_; }
  /// Bytes that belong to no message, those of messages with a wrong checksum included.
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  enum class Found { kNothingHere, kBadChecksum, kNeedsMore, kMessage };
  struct Look {
    Found found = Found::kNothingHere;
    std::size_t size = 0;  ///< Bytes of the message with its frame.
  };
  Look look_at(std::size_t position) const;
  Look look_at_text(std::string_view here) const;
  Look look_at_binary(std::string_view here) const;
  Message extract(std::size_t position, std::size_t size);

  std::string only_header_;
  std::string buffer_;
  std::size_t begin_ = 0;  ///< Bytes before this position are consumed.
  std::uint64_t bad_frames_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

/// The words of a text, which commas separate.
std::vector<std::string_view> split_words(std::string_view text);

/// The data of one field of a binary message, or nullopt if it does not have this field.
std::optional<std::string_view> field(const BinaryMessage& message, Group group, std::uint8_t bit);

/// Acceleration, temperature and time of a message.
struct Measurement {
  /// Specific force along the sensor's x, y, z, m/s2. The reaction, not the pull: an axis that points up
  /// reads +9.8 at rest, so a device that lies with its z axis down reads about -9.8 on z.
  Eigen::Vector3d acceleration_mps2 = Eigen::Vector3d::Zero();
  std::optional<double> temperature_degc;
  std::optional<std::uint64_t> time_startup_ns;  ///< Since the device was started.
};

/// Decodes VNACC, VNIMU, VNYMR, VNMAR or VNQMR, with or without a count (,T...) and a status (,S...) behind.
/// Absent if it is another message, or has not exactly the required number of values.
std::optional<Measurement> decode_text_measurement(std::string_view text);
/// Nullopt if the message holds no acceleration (common field 8 or IMU field 9).
std::optional<Measurement> decode_binary_measurement(const BinaryMessage& message);

/// The meaning of the code of "VNERR": "invalid register" for 8, and so on.
std::string_view error_in_words(unsigned code);

}  // namespace abcal::vectornav
