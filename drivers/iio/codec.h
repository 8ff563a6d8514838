#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/frame.h"

/// The text protocol of iiod, the server of Linux's Industrial I/O (docs/protocols/iiod.md): replies, the
/// description of the devices (XML) and samples. Pure: no port, no clock, no logging.
namespace abcal::iio {

// The devices.

/// How a sample of a channel is stored: "be:s20/32>>12".
struct SampleFormat {
  bool big_endian = false;
  bool is_signed = true;
  unsigned bits = 16;
  unsigned bytes = 2;  ///< 1, 2, 4 or 8.
  unsigned shift = 0;

  bool operator==(const SampleFormat&) const = default;
};
/// Absent if the text is not a format, or is one with several values (X2).
std::optional<SampleFormat> parse_format(std::string_view text);

struct Channel {
  std::string id;  ///< "accel_x"
  bool output = false;
  std::optional<unsigned> index{};  ///< Place in a scan; absent: it is in no scan.
  std::optional<SampleFormat> format{};
  std::vector<std::string> attributes{};

  bool has(std::string_view attribute) const;
};

struct Device {
  std::string id;    ///< "iio:device0", "trigger0"
  std::string name;  ///< Name of the part: "adis16485"; may be empty.
  std::vector<Channel> channels{};
  std::vector<std::string> attributes{};
  std::vector<std::string> debug_attributes{};

  bool has(std::string_view attribute) const;
  bool has_debug(std::string_view attribute) const;
  const Channel* find(std::string_view channel) const;  ///< An input; null: there is none.
};

struct Context {
  std::map<std::string, std::string> attributes{};
  std::vector<Device> devices{};
};
/// Absent if the text is not such a description.
std::optional<Context> parse_context(std::string_view xml);

// Replies.

enum class ReplyKind {
  kNumber,  ///< A line with a number; negative: an error of the system.
  kText,    ///< Its length, the text, a line's end; negative: an error.
  kName,    ///< Like kText, but nothing follows the length 0.
};
wire::FrameVerdict check_reply(ReplyKind kind, std::string_view bytes);
/// The number of the first line. @pre The reply is complete.
std::int64_t number_of(std::string_view reply);
/// Without zeros and blanks at its ends. @pre The reply of kind kText or kName is complete.
std::string text_of(std::string_view reply);

/// The server's answer to VERSION, "0.24.v0.24  ", without its line's end, if the bytes hold such a line;
/// `end`: the position behind it.
struct VersionLine {
  std::string text;
  std::size_t end = 0;
};
std::optional<VersionLine> find_version(std::string_view bytes);

/// The answer to READBUF: one or more chunks, before the first one the mask.
wire::FrameVerdict check_samples(std::string_view bytes, std::size_t wanted, std::string_view mask);
struct Samples {
  std::string bytes;       ///< Contents of whole chunks.
  std::int64_t error = 0;  ///< Negative: the error that ended the samples.
};
/// @pre check_samples() reports that it is complete.
Samples samples_of(std::string_view reply, std::string_view mask);

// Scans.

struct Place {
  SampleFormat format;
  std::size_t offset = 0;
};
/// Positions of the axes and the time in a scan.
struct ScanLayout {
  std::array<Place, 3> axes;
  std::optional<Place> timestamp{};
  std::size_t size = 0;
  std::string mask;  ///< Channel mask in the form that OPEN takes.
};
/// Layout of accel_x, accel_y, accel_z and, if the device has one, timestamp. Absent if these channels are
/// not in its scans.
std::optional<ScanLayout> lay_out(const Device& device);

struct Raw {
  std::int64_t value = 0;
  bool at_end = false;  ///< The value is at an end of the range.
};
/// @pre The place lies within the scan.
Raw value_at(std::string_view scan, const Place& place);

}  // namespace abcal::iio
