#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

/// The wire format of MAVLink 1 and 2 (docs/protocols/mavlink.md): bytes to frames and back. Pure: no port,
/// no clock, no logging. Numbers are little-endian.
namespace abcal::mavlink {

/// Messages that are read or written here.
enum MessageId : std::uint32_t {
  kHeartbeat = 0,
  kParamRequestRead = 20,
  kParamValue = 22,
  kParamSet = 23,
  kScaledImu = 26,
  kCommandLong = 76,
  kCommandAck = 77,
  kHighresImu = 105,
  kAutopilotVersion = 148,
};

enum Command : std::uint16_t {
  kGetMessageInterval = 510,
  kSetMessageInterval = 511,
  kRequestMessage = 512,
};

/// Properties of a message id: seed of its checksum, and length of its payload without and with extensions.
struct MessageKind {
  std::uint32_t id;
  std::uint8_t crc_extra;
  std::uint8_t base_length;
  std::uint8_t full_length;
};
/// Absent: the id is not known, so that its checksum cannot be checked.
std::optional<MessageKind> find_kind(std::uint32_t id);

/// CRC-16/MCRF4XX of the bytes and, behind them, `crc_extra`.
std::uint16_t checksum(std::string_view bytes, std::uint8_t crc_extra);

struct Frame {
  int version = 2;
  std::uint8_t sequence = 0;
  std::uint8_t system = 0;
  std::uint8_t component = 0;
  std::uint32_t id = 0;
  bool known = false;    ///< Its checksum was right; else only its length is known.
  std::string payload;   ///< Payload of a known message, padded with zeros to its full length.
  std::size_t size = 0;  ///< Bytes on the wire.
};

/// Finds frames in a stream of bytes that may begin anywhere, be split anywhere, and be damaged.
///
/// From each byte on: if a frame of a known kind with a right checksum begins here it is given and the search
/// goes on behind it, else at the next byte. A frame of an unknown kind is skipped as a whole only where one
/// is due, directly behind another. The result does not depend on how the bytes were split.
class FrameParser {
 public:
  void feed(std::string_view bytes);
  std::optional<Frame> next();
  /// The next whole frame *after* an incomplete one, for a line that has become silent: a false beginning may
  /// claim bytes that never arrive.
  std::optional<Frame> next_behind_partial();
  void lose_track();
  bool has_partial() const { return begin_ < buffer_.size(); }
  std::uint64_t bad_frames() const { return bad_frames_; }
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  void skip_one();

  std::string buffer_;
  std::size_t begin_ = 0;  ///< Bytes before this position are consumed.
  bool in_step_ = false;   ///< A frame has ended where the next one begins.
  std::uint64_t bad_frames_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

struct Heartbeat {
  std::uint8_t type = 0;
  std::uint8_t autopilot = 0;
  std::uint8_t base_mode = 0;
  bool is_armed() const { return (base_mode & 0x80U) != 0; }
  bool is_vehicle() const;  ///< Not a ground station, a gimbal or another part without an autopilot.
};
std::optional<Heartbeat> decode_heartbeat(const Frame& frame);
inline constexpr std::uint8_t kArduPilot = 3;
inline constexpr std::uint8_t kPx4 = 12;
std::string autopilot_name(std::uint8_t autopilot);

struct Acceleration {
  Eigen::Vector3d output_mps2 = Eigen::Vector3d::Zero();
  std::uint64_t time_us = 0;       ///< Since the autopilot's start, or of its clock.
  std::uint64_t time_span_us = 0;  ///< After which the time begins again at 0; 0: never.
  std::optional<double> temperature_degc{};
  bool clipped = false;  ///< A word is at the end of its range.
};
/// HIGHRES_IMU or SCALED_IMU; nullopt for others, or without a new and possible acceleration.
std::optional<Acceleration> decode_acceleration(const Frame& frame);

struct Version {
  std::string serial_number;  ///< Empty: it is not reported.
  std::string firmware;
};
std::optional<Version> decode_version(const Frame& frame);

struct Acknowledgement {
  std::uint16_t command = 0;
  std::uint8_t result = 0;  ///< 0: accepted.
};
std::optional<Acknowledgement> decode_acknowledgement(const Frame& frame);
std::string_view result_in_words(unsigned result);

/// PARAM_VALUE. A whole number is kept in the bytes of the float by all but ArduPilot, which converts it.
struct Parameter {
  std::string name;
  double value = 0.0;
  std::uint8_t type = 0;  ///< 9: a float; below: whole numbers.
};
std::optional<Parameter> decode_parameter(const Frame& frame, std::uint8_t autopilot);

/// Sender of our messages: a ground station, next to others.
inline constexpr std::uint8_t kOurSystem = 254;
inline constexpr std::uint8_t kOurComponent = 190;

/// A frame of a known kind. @throws std::invalid_argument for another, or a payload that is not as long.
std::string make_frame(int version, std::uint8_t sequence, std::uint32_t id, std::string_view payload);
std::string command_long(std::uint8_t system, std::uint8_t component, std::uint16_t command,
                         const std::array<float, 2>& parameters);
std::string param_request_read(std::uint8_t system, std::uint8_t component, std::string_view name);
/// Sets a parameter of type float.
std::string param_set(std::uint8_t system, std::uint8_t component, std::string_view name, float value);
/// Heartbeat of a ground station.
std::string our_heartbeat();

}  // namespace abcal::mavlink
