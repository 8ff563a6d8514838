#pragma once

#include <chrono>
#include <memory>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::newport_esp {

/// How long a reply may take: the controller can be silent for 2 to 5 s after it has run into a travel limit
/// (docs/protocols/newport_esp.md).
inline constexpr Clock::Duration kReplyDeadline = std::chrono::seconds(6);

/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(15);

/// Two axes of a Newport ESP301, ESP300 or ESP302 over RS-232 (19200 baud, RTS/CTS).
///
/// Angles are the controller's own, in degrees: the unit of each axis is checked before anything else. The
/// controller cannot say whether an axis is homed, so an axis counts as referenced only after home() through
/// this object, and no longer once the controller was switched off and on (its error time stamp has gone
/// back). StageSettings::axis_names are axis numbers; one of them may be empty: that axis is then not on this
/// controller, and calls for it throw kNotReady.
///
/// identify() reads and thereby clears the controller's error buffer; the serial numbers are those of the two
/// stages (ID?), because the controller reports none of its own. It throws kWrongIdentity for a device that
/// is not an ESP controller, an axis that it does not have, a unit other than degrees. home() switches the
/// motor on and starts the home search that the controller is set up for (OR without a number). move_to()
/// throws kNotReady (not homed; motor off), kOutOfTravel (software limit), kRefused for any other error code,
/// with its text. motion_state() is MD?; once that says done, the error buffer must be empty too: kRefused if
/// the motion ended with an error (following error, limit, ...). halt() sends ST (all axes), then asks MD?.
///
/// One owner thread; halt() from any.
class NewportEspStage final : public wire::LineStage {
 public:
  /// Sends nothing yet.
  /// @throws std::invalid_argument for invalid settings: no axis, one axis twice, an axis that is not a
  /// number from 1 to 6, a speed that is not a positive number, any address.
  NewportEspStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings);
};

}  // namespace abcal::newport_esp
