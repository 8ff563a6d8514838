#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"
#include "drivers/wire/frame.h"
#include "drivers/wire/readable_bytes.h"

/// The wire format of PI's General Command Set 2.0: bytes to commands and back, no port, no clock. Sources:
/// the replies seen on the wire and the rules of PIPython (docs/protocols/pi_gcs.md); the daisy-chain form of
/// single-byte commands is general knowledge, not confirmed.
namespace abcal::pi_gcs {

/// Commands of one byte, sent without LF and answered also while the controller is busy.
inline constexpr char kAskStatus = 0x04;    ///< #4: status words, hexadecimal.
inline constexpr char kAskMotion = 0x05;    ///< #5: mask of the moving axes, hexadecimal.
inline constexpr char kAskReady = 0x07;     ///< #7: one byte, 0xB1 ready or 0xB0 busy.
inline constexpr char kStopAllAxes = 0x18;  ///< #24: abrupt stop; ERR? is then 10.

/// Controller error codes that the driver acts on (ERR?).
inline constexpr int kErrorUnknownCommand = 2;
inline constexpr int kErrorUnreferencedOrServoOff = 5;
inline constexpr int kErrorPositionOutOfLimits = 7;
inline constexpr int kErrorStoppedByCommand = 10;
inline constexpr int kErrorNoReference = 31;

/// A command line: `text` and LF, with "<address> " before it for a controller in a daisy chain (empty:
/// none).
std::string command_line(std::string_view text, std::string_view address = {});

/// A single-byte command; in a daisy chain "<address> <byte>" and LF.
std::string single_byte(char code, std::string_view address = {});

/// "MOV <axis> <degrees>", to a millionth of a degree. @pre target is finite.
std::string move_command(std::string_view axis, Angle target);

/// The one end-of-reply rule: a LF that is not preceded by a space. Lines longer than kLongestReply are not
/// replies.
wire::FrameVerdict check_reply(std::string_view bytes);
inline constexpr std::size_t kLongestReply = 65536;  ///< HLP? of a large controller has some 20 kB.

/// The lines of a reply without their endings (space LF, LF, CR LF). In a daisy chain the first line must
/// start with "0 <address> ", which is removed; nullopt if it does not.
std::optional<std::vector<std::string>> reply_lines(std::string_view reply, std::string_view address = {});

struct AxisValue {
  std::string axis;   ///< Left of '='; "1", or "1 14" for a parameter of an axis.
  std::string value;  ///< Right of '='.
};

/// Lines "axis=value"; nullopt if one of them is anything else.
std::optional<std::vector<AxisValue>> parse_axis_values(const std::vector<std::string>& lines);

/// The value of `axis` in a reply of "axis=value" lines; nullopt if absent.
std::optional<std::string> axis_value(const std::vector<std::string>& lines, std::string_view axis);

/// Like axis_value(), as a finite number or as a flag (0 or 1); absent if the text is neither.
std::optional<double> axis_number(const std::vector<std::string>& lines, std::string_view axis);
std::optional<bool> axis_flag(const std::vector<std::string>& lines, std::string_view axis);

/// The reply to "SPA? <axis> <parameter>": "<axis> <parameter>=v" or "<parameter>=v", parameter decimal or
/// 0x...
std::optional<std::string> parameter_text(const std::vector<std::string>& lines, unsigned parameter);
/// Like parameter_text(), as a number.
std::optional<double> parameter_number(const std::vector<std::string>& lines, unsigned parameter);

/// A finite number that fills the text (but for spaces around it).
std::optional<double> parse_number(std::string_view text);

/// The reply to ERR?.
std::optional<int> parse_error_code(const std::vector<std::string>& lines);

/// The commands in a reply to HLP?: "MOV", "#5", "*IDN?"; nullopt if it is not such a list.
std::optional<std::vector<std::string>> parse_help(const std::vector<std::string>& lines);

/// The reply to #5: bit k-1 is axis k in the order of SAI?.
std::optional<std::uint64_t> parse_motion_mask(const std::vector<std::string>& lines);

/// One axis's word of the reply to #4.
struct AxisStatus {
  bool negative_limit = false;
  bool positive_limit = false;
  bool servo_on = false;
  bool moving = false;
  bool homing = false;
};

/// The reply to #4: "0x" and four hexadecimal digits an axis, the first axis first.
std::optional<std::vector<AxisStatus>> parse_status(const std::vector<std::string>& lines);

/// The one-byte reply to #7: true ready, false busy.
std::optional<bool> parse_ready(char reply);

struct Identity {
  std::string maker;
  std::string model;
  std::string serial_number;  ///< Empty: older firmware does not report it.
  std::string firmware;
};

/// The reply to *IDN?; nullopt if it is not from a controller by Physik Instrumente.
std::optional<Identity> parse_identity(const std::vector<std::string>& lines);

/// Whether PUN? names degrees.
bool is_degrees(std::string_view unit);

/// Meaning of an error code in words; "unknown error" for a code that is not in our list.
std::string_view error_text(int code);

/// Bytes as text for a message.
using wire::printable;

}  // namespace abcal::pi_gcs
