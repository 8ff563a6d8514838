#pragma once

#include <memory>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/line_exchange.h"

namespace abcal::described {

/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(8);

/// Two rotary axes of a controller that a description describes (docs/drivers/described.md): it speaks lines
/// of text, and answers in the order of its commands.
///
/// identify() throws kWrongIdentity for an identity that is not of the description's models. Before the first
/// command that may move an axis, the commands of [[prepare]] are sent, and the axes must neither move nor
/// have moved after them: otherwise all axes are halted, and kRefused is thrown. Every command is
/// acknowledged by its reply, or read back and compared; a refusal has the fault that the description gives
/// it. motion_state() throws the fault of a status that is one.
///
/// One owner thread; halt() from any.
class DescribedStage final : public wire::LineStage {
 public:
  /// Sends nothing yet.
  /// @throws std::invalid_argument for settings that cannot be meant, or without a description.
  DescribedStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings);
};

}  // namespace abcal::described
