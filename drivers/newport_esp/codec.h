#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/angle.h"
#include "drivers/wire/frame.h"
#include "drivers/wire/readable_bytes.h"

/// The wire format of Newport's ESP301 family: bytes to commands and back, no port, no clock. Source:
/// docs/protocols/newport_esp.md (EPICS traces, InstrumentKit, Odemis). Replies carry neither a name nor a
/// checksum: the meaning of a line depends on the query.
namespace abcal::newport_esp {

/// General error codes that the driver acts on.
inline constexpr int kErrorUnknownCommand = 6;
inline constexpr int kErrorNoSuchAxis = 9;

/// Axis error codes, without the axis's hundreds.
inline constexpr int kAxisErrorPositiveSoftLimit = 6;
inline constexpr int kAxisErrorNegativeSoftLimit = 7;
inline constexpr int kAxisErrorNotConnected = 8;
inline constexpr int kAxisErrorMotorOff = 13;

inline constexpr int kUnitDegrees = 7;  ///< SN?

/// A command line: `text` and CR.
std::string command_line(std::string_view text);

/// "<axis>PA<degrees>", to a millionth of a degree. @pre target is finite.
std::string move_command(std::string_view axis, Angle target);

/// One line: ends with CR, LF or CR LF (a lone LF after a CR that was already taken is an empty line). Lines
/// longer than kLongestReply are not replies.
wire::FrameVerdict check_reply(std::string_view bytes);
inline constexpr std::size_t kLongestReply = 256;

/// The text of a line, without its end and the blanks around it; nullopt if a byte is not printable.
std::optional<std::string> line_text(std::string_view line);

/// An unsolicited line: E and a code from 35 to 42 (as EPICS sees and skips them).
bool is_unsolicited(std::string_view text);

/// A finite number that fills the text.
std::optional<double> parse_number(std::string_view text);
/// "0" or "1".
std::optional<bool> parse_flag(std::string_view text);
/// SN?: 0 to 11.
std::optional<int> parse_unit(std::string_view text);
/// Name of a unit: "deg", "mm", ...
std::string_view unit_name(int unit);

/// The reply to TB?: "0, 450322, NO ERROR DETECTED".
struct ErrorReport {
  int code = 0;
  std::uint64_t time_stamp = 0;  ///< Counts from when the controller was switched on.
  std::string text;
};
std::optional<ErrorReport> parse_error_report(std::string_view text);

/// Meaning of an error code in words: "axis 1: following error"; "unknown error" for a code that is not in
/// our list.
std::string error_text(int code);
/// The axis of an axis error; 0: a general one.
constexpr int error_axis(int code) {
  return code >= 100 ? code / 100 : 0;
}

struct Identity {
  std::string model;     ///< "ESP301"
  std::string firmware;  ///< "3.0.1 6/1/99"
};
/// The reply to VE?: "ESP301 Version 3.0.1 6/1/99"; nullopt if it is not an ESP300 to ESP302.
std::optional<Identity> parse_identity(std::string_view text);

/// The reply to ID?: "URS100BCC, SN12345".
struct StageIdentity {
  std::string model;
  std::string serial_number;  ///< "12345"; empty if not reported.
};
std::optional<StageIdentity> parse_stage_identity(std::string_view text);

/// Bytes as text for a message.
using wire::printable;

}  // namespace abcal::newport_esp
