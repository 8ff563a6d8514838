#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/frame.h"
#include "drivers/wire/readable_bytes.h"

/// The wire format of Newport's XPS controllers: bytes to requests and replies, no port, no clock. Source:
/// the public XPS Programmer's Manual; [unverified against a device].
namespace abcal::newport_xps {

/// Terminator of every reply.
inline constexpr std::string_view kReplyEnd = ",EndOfAPI";
inline constexpr std::size_t kLongestReply = 4096;

/// "<error>,<values>,EndOfAPI".
wire::FrameVerdict check_reply(std::string_view bytes);

struct Reply {
  int code = 0;        ///< 0: done.
  std::string values;  ///< Separated by commas; of an error: the request, or words.
};

/// A whole reply; nullopt if the frame is not one.
std::optional<Reply> parse_reply(std::string_view frame);

/// A decimal number that fills the text.
std::optional<double> parse_number(std::string_view text);
/// Exactly the expected number of values; absent for more or fewer.
std::optional<std::vector<double>> parse_numbers(std::string_view values, std::size_t count);
std::optional<int> parse_state(std::string_view text);

struct Identity {
  std::string model;     ///< "XPS-C8"
  std::string firmware;  ///< "V2.6.0"; empty: not reported.
};
/// The reply to FirmwareVersionGet: "XPS-C8 Firmware V2.6.0".
std::optional<Identity> parse_identity(std::string_view text);

/// Meaning of the state of a group for a motion.
enum class GroupState {
  kNotInitialised,  ///< 0 to 9, 50, 63: never, or after an error or a kill.
  kReady,           ///< 10 to 19
  kDisabled,        ///< 20 to 40: by a command or an error; the motor is off.
  kNotReferenced,   ///< 42
  kHoming,          ///< 43, 64, and 41 while the motor is initialised
  kMoving,          ///< 44 to 49, 51 and all others
};
GroupState meaning_of(int state);
std::string_view state_text(int state);
std::string_view error_text(int code);

using wire::printable;

}  // namespace abcal::newport_xps
