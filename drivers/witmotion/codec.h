#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

/// The wire format of WitMotion sensors (WIT standard communication protocol): bytes to frames and back.
/// Pure: no port, no clock, no logging.
///
/// A frame is 55, type, four 16-bit words (little-endian), and the sum of these ten bytes modulo 256. A
/// command is FF AA, a register and a 16-bit value; only a read is answered.
namespace abcal::witmotion {

inline constexpr std::size_t kFrameBytes = 11;

/// Types of frames; all from 50 to 5F are taken for frames.
enum FrameType : std::uint8_t { kAcceleration = 0x51, kAngle = 0x53, kRegisters = 0x5F };

enum Register : std::uint8_t {
  kSave = 0x00,                ///< 0: stores all registers.
  kOutputMask = 0x02,          ///< Bit 0 time, 1 acceleration, 2 angular rate, 3 angle, 4 magnetic field.
  kRate = 0x03,                ///< rate_code().
  kBaud = 0x04,                ///< baud_rate().
  kAccelerationOffset = 0x05,  ///< And 06, 07: x, y, z in kOffsetStepG, signed; subtracted.
  kAccelerationRange = 0x21,   ///< range_g().
  kRead = 0x27,                ///< Written with the first of four registers to be read.
  kVersion = 0x2E,
  kLock = 0x69,  ///< Written with kUnlock: registers may be written for the next ten seconds.
};
inline constexpr std::uint16_t kUnlock = 0xB588;
inline constexpr std::uint16_t kAccelerationOnly = 1U << 1U;

/// FF AA register value.
std::string write_register(Register where, std::uint16_t value);
/// The question for four registers, from `first` on.
std::string read_registers(Register first);

/// A frame whose sum was right.
struct Frame {
  std::uint8_t type = 0;
  std::array<std::uint16_t, 4> words{};
  std::size_t size = kFrameBytes;  ///< Bytes on the wire.
};

/// Finds frames in a stream of bytes that may begin anywhere, be split anywhere, and be damaged.
///
/// From each byte on: if a frame with a right sum begins here it is given and the search goes on behind it,
/// else at the next byte. The result does not depend on how the bytes were split. The 8-bit sum detects every
/// single wrong byte of a frame; it passes one in 256 of frames that are wrong throughout.
class FrameParser {
 public:
  void feed(std::string_view bytes);

  /// The next frame in the bytes fed so far; absent if it needs more bytes.
  std::optional<Frame> next();

  /// Called where bytes are missing: held-back bytes belong to no frame.
  void lose_track();

  /// True if bytes are held back that may begin a frame.
  bool has_partial() const { return begin_ < buffer_.size(); }

  /// Something that was framed like a frame and had a wrong sum.
  std::uint64_t bad_frames() const { return bad_frames_; }
  /// Bytes that belong to no frame, those of frames with a wrong sum included.
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  std::string buffer_;
  std::size_t begin_ = 0;  ///< Bytes before this position are consumed.
  std::uint64_t bad_frames_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

/// Content of an acceleration frame (51).
struct Acceleration {
  /// Specific force along the sensor's x, y, z, g. The reaction, not the pull: an axis that points up reads
  /// +1 at rest.
  Eigen::Vector3d output_g = Eigen::Vector3d::Zero();
  double temperature_degc = 0.0;
  bool clipped = false;  ///< A word is at the end of its range.
};
inline constexpr double kFormatFullScaleG = 16.0;  ///< Value of the largest word, g.
inline constexpr double kStepG = kFormatFullScaleG / 32768.0;
inline constexpr double kOffsetStepG = 1e-4;

/// Nullopt if it is another frame.
std::optional<Acceleration> decode_acceleration(const Frame& frame);

/// The code of an output rate in readings per second, nullopt for others than: 1, 2, 5, 10, 20, 50, 100, 200.
std::optional<std::uint16_t> rate_code(double rate_hz);
/// The nearest output rate.
double nearest_rate_hz(double rate_hz);

/// Baud rate from the content of register 04; absent if the code is not known.
std::optional<double> baud_rate(std::uint16_t code);
/// Range in g from the content of register 21; absent if the code is not known [unverified against a device].
std::optional<double> range_g(std::uint16_t code);

}  // namespace abcal::witmotion
