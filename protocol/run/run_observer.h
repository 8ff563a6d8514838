#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string_view>

#include "protocol/record/run_file.h"
#include "protocol/record/run_interrupted.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Activity of a run.
enum class RunPhase {
  kHoming,
  kWarmingUp,
  kHolding,
  kMoving,
  kSettling,
  kDwelling,
  kTemperature,
  kReconnecting,
  kParking
};
/// "homing", "reading", ...
std::string_view to_string(RunPhase phase);

/// Kinds of events in the run file that observers distinguish. Others are "repeated", "temperature",
/// "stable", "full scale", "park failed" and so on: text for a person.
inline constexpr std::string_view kFlagEvent = "flag";      ///< An angle was measured with a flag.
inline constexpr std::string_view kPortLostEvent = "lost";  ///< A port vanished; the run waits for it.
inline constexpr std::string_view kFileEvent = "file";      ///< The run file was moved, or is back.
/// The watchdog halted the stage; the text gives the reason.
inline constexpr std::string_view kWatchdogEvent = "watchdog";

/// Receives the events of a run as they happen. Must return at once: the hardware never waits for a screen.
class RunObserver {
 public:
  virtual ~RunObserver() = default;
  /// `position` is the index in the plan of the angle that is being worked on.
  virtual void phase(std::size_t position, RunPhase phase) = 0;
  /// An angle was measured and is on the disk: the part of each item, at least one.
  virtual void dwells(std::size_t position, std::span<const ItemDwell> dwells) = 0;
  /// A message for a person; it is also in the run file, as an event of this kind.
  /// @param item  the number of the item that it is about; absent: the whole bench
  virtual void notice(std::string_view kind, const Message& text, std::optional<int> item) = 0;
  /// Called between two angles, and repeatedly while it returns true: the stage does not move meanwhile.
  virtual bool hold_wanted() { return false; }
};

}  // namespace abcal
