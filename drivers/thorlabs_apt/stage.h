#pragma once

#include <chrono>
#include <memory>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::thorlabs_apt {

inline constexpr Clock::Duration kReplyDeadline = std::chrono::seconds(1);
/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(8);

/// Rotary stages of Thorlabs on one APT (Kinesis) controller: two bays of a benchtop controller (BBD, BSC),
/// or the only channel of a unit (K10CR1, KDC101), which is one half of a split stage.
///
/// StageSettings::axis_names are the number of a bay, or of a unit's channel, followed by the stage where the
/// controller does not report it: "1", "2 HDR50". One name may be empty: that axis is then not on this port.
/// The stages turn without end: targets up to one turn either way of the controller's zero are accepted.
///
/// The protocol acknowledges neither settings nor commands: settings are read back, and a motion counts as
/// accepted once the status shows it. identify() throws kWrongIdentity for a device that is not an APT
/// controller, or if the counts per degree are unknown. motion_state() throws kRefused for the fault bits of
/// the status and for a motion that has ended far from its target. halt() sends a profiled stop to both axes.
///
/// One owner thread; halt() from any.
class ThorlabsAptStage final : public wire::LineStage {
 public:
  /// Sends nothing yet. @throws std::invalid_argument for invalid settings.
  ThorlabsAptStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings);
};

}  // namespace abcal::thorlabs_apt
