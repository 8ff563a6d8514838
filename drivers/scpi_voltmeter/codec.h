#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/frame.h"

/// The replies of SCPI voltmeters (docs/protocols/scpi_voltmeters.md): bytes to values, no port, no clock.
/// SCPI has no checksum and names no query in a reply, so every form here is strict, and no two of them can
/// be taken for each other.
namespace abcal::scpi {

/// Longer than this no reply is.
inline constexpr std::size_t kLongestReply = 1024;

/// One reply, up to its LF.
wire::FrameVerdict check_reply(std::string_view bytes);

/// A whole reply without its end (LF or CR LF) and without blanks around it.
std::string_view text_of(std::string_view reply);

/// The answer to *IDN?: "HEWLETT-PACKARD,34970A,0,13-2-2".
struct Identity {
  std::string maker;
  std::string model;  ///< Without the word MODEL, which Keithley puts before it.
  std::string serial_number;
  std::string firmware;

  bool operator==(const Identity&) const = default;
};
/// Nullopt unless there are four words, of which the first two are not empty, and the first begins with a
/// letter.
std::optional<Identity> parse_identity(std::string_view text);

/// The answer to SYST:ERR?: "-222,\"Data out of range\"". Code 0: no error.
struct ErrorReport {
  int code = 0;
  std::string words;

  bool operator==(const ErrorReport&) const = default;
};
std::optional<ErrorReport> parse_error(std::string_view text);

/// One reading of a scan.
struct ChannelReading {
  double volts = 0.0;  ///< 0 if overload.
  int overload = 0;    ///< +1 or -1: beyond the measuring range on this side (+-9.9E37).
  std::optional<int> channel;

  bool operator==(const ChannelReading&) const = default;
};
/// "+5.0E-01,-2.5E-01" or, with channels, "+5.0E-01,101,-2.5E-01,102"; a number may carry the unit V or VDC.
/// Nullopt if a number is not finite, cannot be a voltage (9.91E37 is SCPI's "not a number"), or anything
/// follows.
std::optional<std::vector<ChannelReading>> parse_readings(std::string_view text, bool with_channels);

/// Content of a definite-length block: "#214(@101,102,103)" gives "(@101,102,103)". Absent unless the block
/// fills the text.
std::optional<std::string_view> parse_block(std::string_view text);

/// "(@101,102,103)".
std::string channel_list(std::span<const int> channels);
/// The channels of a list, ranges ("101:103") written out. Nullopt if it is not a list, or has over 1000.
std::optional<std::vector<int>> parse_channel_list(std::string_view text);

}  // namespace abcal::scpi
