#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/frame.h"
#include "drivers/wire/readable_bytes.h"

/// The wire format of the Zaber ASCII protocol: bytes to commands and back, no port, no clock. Source:
/// docs/protocols/zaber_ascii.md (the vectors and parser cases of the zproto library).
namespace abcal::zaber_ascii {

/// Sum of all bytes, negated, modulo 256: `content` is the text between the first character and ':'.
std::uint8_t checksum(std::string_view content);

/// "/<content>:<checksum>" and LF.
std::string command_line(std::string_view content);

/// A command to an axis (0: all) of a device (0: all), with a message id from 0 to 99. Empty data asks for
/// the status.
std::string command(int device, int axis, int id, std::string_view data);

/// One line, up to its LF (or a single CR). Anything longer than kLongestLine is invalid.
wire::FrameVerdict check_line(std::string_view bytes);
inline constexpr std::size_t kLongestLine = 1024;

enum class MessageKind { kReply, kInfo, kAlert };

struct Message {
  MessageKind kind = MessageKind::kReply;
  int device = 0;
  int axis = 0;
  std::optional<int> id;
  bool accepted = false;      ///< OK, not RJ. Replies only.
  bool busy = false;          ///< BUSY, not IDLE. Replies and alerts.
  std::string warning;        ///< Two letters, or "--". Replies and alerts.
  std::string data;           ///< The rest of the message. A reply has at least one word.
  bool continues = false;     ///< The text continues in the next message.
  bool has_checksum = false;  ///< It has one, and it holds.
};

/// A line without its end. Nullopt if it is not a message, or if its checksum is wrong; with
/// `checksum_required` also if it has none.
std::optional<Message> parse_message(std::string_view line, bool checksum_required);

/// The message of a received line: the line without its end, and if other bytes precede it on the same line,
/// the part from the message's first character, if its checksum holds.
std::optional<Message> find_message(std::string_view line, bool checksum_required);

/// A whole number or decimal that fills the text.
std::optional<double> parse_number(std::string_view text);

/// The data of a reply to "warnings": "02 WR NC".
std::optional<std::vector<std::string>> parse_warnings(std::string_view data);

/// Whether a flag is a fault (F*): the axis has stopped, or must.
constexpr bool is_fault(std::string_view flag) {
  return flag.size() == 2 && flag[0] == 'F';
}

/// Meaning of a warning flag in words: "WR" is "no reference position".
std::string_view warning_text(std::string_view flag);

/// Meaning of the reason of a rejection in words.
std::string_view rejection_text(std::string_view reason);

/// Bytes as text for a message.
using wire::printable;

}  // namespace abcal::zaber_ascii
