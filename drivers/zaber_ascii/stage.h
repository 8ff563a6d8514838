#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::zaber_ascii {

/// How long a reply may take; devices answer within milliseconds, also while moving.
inline constexpr Clock::Duration kReplyDeadline = std::chrono::seconds(1);

/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(8);

/// Two rotary axes of Zaber devices that speak the ASCII protocol (firmware 6 and 7): of one controller with
/// several axes, or of two devices in a daisy chain.
///
/// StageSettings::axis_names are "device axis" ("1 2" is axis 2 of device 1), or one number: axis n of the
/// device in `address`, if that is given; else axis n of the only device that answers; else, in a chain,
/// device n, which must have one axis. One name may be empty: that axis is then not on this line, and calls
/// for it throw kNotReady.
///
/// Angles are get pos x 360 / get limit.cycle.dist. Every command carries a message id and a checksum, so a
/// late or damaged reply is never taken for another one. Warning flags are reported in words: a fault (F*)
/// makes any call throw.
///
/// identify() throws kWrongIdentity for a device that does not speak Zaber ASCII, a device or axis that is
/// absent (lists those present), an axis that does not rotate. home() clears the warnings, enables the driver
/// if it is off, and homes. move_to() throws kNotReady (no reference: WR, WH), kOutOfTravel, kRefused with
/// the flag or the reason of the rejection in words. motion_state() throws kRefused for a fault flag (F*),
/// and for a motion that something else ended: interrupted (NI), manual control (NC), unexpected limit (WL),
/// displaced (WM). halt() sends "stop" to all devices, then asks until the axes of this stage are idle;
/// halt_axes() reports each axis, so that a silent device does not hide the answer of the other one.
///
/// One owner thread; halt() from any.
class ZaberAsciiStage final : public wire::LineStage {
 public:
  /// Sends nothing yet.
  /// @throws std::invalid_argument for invalid settings.
  ZaberAsciiStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings);
};

/// The rotating axes of all devices on the line, as StageSettings::axis_names: "1 1", "2 1". Asks only.
/// @throws InstrumentError as identify()
std::vector<std::string> axes_on_line(std::unique_ptr<wire::ByteStream> stream, Clock& clock);

}  // namespace abcal::zaber_ascii
