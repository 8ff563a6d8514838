#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::pi_gcs {

/// How long a reply may take. Controllers answer within tens of milliseconds also while moving; PIPython
/// waits 7 s because some of its queries start a self-test; ours do not.
inline constexpr Clock::Duration kReplyDeadline = std::chrono::seconds(2);

/// For queries that a controller need not know: one that does not know a query stays silent (and sets error
/// 2).
inline constexpr Clock::Duration kOptionalReplyDeadline = std::chrono::milliseconds(500);

/// For HLP?: up to 20 kB, which a line of 38400 baud takes 5 s to carry.
inline constexpr Clock::Duration kHelpDeadline = std::chrono::seconds(8);

/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(5);

/// Two axes of a PI controller that speaks GCS 2.0 (C-884, C-863, E-861, ...), over serial or TCP.
///
/// In a daisy chain the axes may be on two controllers of the line: StageSettings::axis_names are then
/// "<address> <name>" each. Commands that a controller does not list in HLP? are not sent to it.
///
/// Angles are the controller's own, in degrees: the controller's unit is checked before anything else. The
/// controller is identified at the first call, whichever it is. StageSettings::axis_names may leave one name
/// empty: that axis is then not on this controller, and calls for it throw kNotReady.
///
/// One owner thread; halt() from any.
///
/// identify() throws kWrongIdentity for a device that is not a PI controller, for an axis that it does not
/// have (lists those it has), and for a unit other than degrees. home() uses the reference switch (FRF), or
/// without one the negative limit switch (FNL). move_to() throws kNotReady if the axis has lost its reference
/// or its servo (errors 5 and 31), kOutOfTravel (error 7), kRefused for any other error code, with its text.
/// motion_state() is the controller's present answer (#5, or #4, or ONT? where these are not known): stopped
/// is not yet "on target". halt() sends #24 (in a chain also STP to each controller), then asks until the
/// controller reports that it was stopped (error 10) or that nothing moves; halt_axes() reports each axis, so
/// that a silent controller does not hide the answer of the other one.
class PiGcsStage final : public wire::LineStage {
 public:
  /// Sends nothing yet.
  /// @throws std::invalid_argument for invalid settings: no axis, one axis twice, a speed that
  /// is
  ///   not a positive number, an address that is not a number from 1 to 16.
  PiGcsStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings);
};

/// How long each address of a chain is waited for.
inline constexpr Clock::Duration kAddressDeadline = std::chrono::milliseconds(100);

/// The axes of the controllers on the line, as StageSettings::axis_names: "1", "2" of one alone, "1 1", "2 1"
/// of a daisy chain, whose addresses are asked one after the other. Asks only.
std::vector<std::string> axes_on_line(std::unique_ptr<wire::ByteStream> stream, Clock& clock);

}  // namespace abcal::pi_gcs
