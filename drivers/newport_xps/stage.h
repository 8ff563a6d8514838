#pragma once

#include <chrono>
#include <memory>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/newport_xps/codec.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::newport_xps {

inline constexpr Clock::Duration kReplyDeadline = std::chrono::seconds(2);
/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(8);

/// Two rotary axes of a Newport XPS controller, each a group of its own.
///
/// A motion blocks the connection on which it was commanded until it has ended. So there are three: one for
/// questions and halting, and one for the motions of each axis.
///
/// StageSettings::axis_names are positioners ("Group1.Pos"), or a number n for "Groupn.Pos", as the
/// controller's own configuration names them. One name may be empty: that axis is then not on this
/// controller.
///
/// identify() throws kWrongIdentity for a device that is not an XPS and for a missing positioner. home()
/// kills the group if it was initialised, initialises it and starts the home search. move_to() throws
/// kNotReady (not homed, moving), kOutOfTravel, kRefused with the controller's error in words. motion_state()
/// throws kRefused if the state of the group shows that the motion has ended before its target. halt() aborts
/// the motions (GroupMoveAbort); a home search is ended by GroupKill, which also switches the motor off.
///
/// One owner thread; halt() from any.
class NewportXpsStage final : public wire::LineStage {
 public:
  /// Sends nothing yet. The first stream is for questions, the others for motions of X and Z; these two are
  /// not needed for identify().
  /// @throws std::invalid_argument for invalid settings.
  NewportXpsStage(std::vector<std::unique_ptr<wire::ByteStream>> streams, Clock& clock,
                  const StageSettings& settings);
};

}  // namespace abcal::newport_xps
