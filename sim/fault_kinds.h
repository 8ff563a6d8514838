#pragma once

#include <chrono>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::sim {

/// Faults of a simulated bench. The first group happens on the wire (FaultyStream), the second in the world
/// (SimBench::inject).
enum class FaultKind {
  // On the wire.
  kSilence,        ///< No reply is sent.
  kGarbage,        ///< Random bytes precede the reply.
  kFlippedBits,    ///< One bit of the reply is wrong.
  kDroppedBytes,   ///< Some bytes of the reply are missing.
  kSplitFrame,     ///< The reply arrives one byte at a time.
  kLateReply,      ///< The reply is delayed.
  kReplacedReply,  ///< Another text is returned, e.g. a refusal.
  kUnplug,         ///< The port vanishes: every call throws kLinkLost.
  kPowerCycle,     ///< Like kUnplug, and the instrument loses its power: it restarts when the fault ends.
  // In the world.
  kStuckOutput,     ///< The output stays at the value it had.
  kClippedOutput,   ///< The output clips at a small full scale, and the instrument reports it.
  kNotFinite,       ///< The output is NaN.
  kNoOutput,        ///< The accelerometer makes no readings.
  kStalledAxis,     ///< An axis stops on its way and never reports that it is done.
  kStopsShort,      ///< Moves end short of their target; the controller reports success.
  kLostReference,   ///< The controller forgets the reference of an axis.
  kRefusedMove,     ///< The controller refuses to move.
  kMissedStep,      ///< An axis is off by some degrees, and its encoder does not see it.
  kMovedAxis,       ///< An axis is off by some degrees, as its encoder reports.
  kLostController,  ///< The controller of an axis is disconnected from its daisy chain: it neither receives
                    ///< nor answers.
  kChamberAlarm,    ///< The thermal chamber has an alarm.
  kChamberDoor,     ///< Its door is open.
};

struct FaultDescription {
  FaultKind kind;
  std::string_view name;  ///< Name in scripts and on command lines: "silence".
  std::string_view what;  ///< One line for people.
  bool on_the_wire;       ///< False: in the world.
};

/// All kinds, in the order of the enumeration.
const std::vector<FaultDescription>& fault_descriptions();

/// @throws std::invalid_argument naming the known ones.
const FaultDescription& fault_description(std::string_view name);

/// Delay of a link: replies arrive later by `latency`, and by up to `jitter` more, in order.
struct LinkTiming {
  Clock::Duration latency = Clock::Duration::zero();
  Clock::Duration jitter = Clock::Duration::zero();

  bool operator==(const LinkTiming&) const = default;
};

/// A fault of the wire and when it happens: from the `at_write`-th write on (1 is the first; a command is one
/// write) or from the instant `at` on, whichever is given; at once if neither is.
struct WireFault {
  FaultKind kind = FaultKind::kSilence;
  std::optional<std::size_t> at_write{};
  std::optional<Clock::Instant> at{};
  std::optional<Clock::Instant> until{};            ///< Ends then; absent: lasts.
  std::optional<std::size_t> for_writes{};          ///< Ends with that many writes answered; absent: lasts.
  std::string text = {};                            ///< kReplacedReply: the text that is returned instead.
  Clock::Duration delay = std::chrono::seconds(1);  ///< kLateReply: by how much.
};

/// A fault of the world, from `at` until `until`.
struct WorldFault {
  FaultKind kind = FaultKind::kStuckOutput;
  Clock::Instant at = Clock::Instant::min();
  Clock::Instant until = Clock::Instant::max();
  StageAxis axis = StageAxis::kX;  ///< Stage faults.
  double value = 0.0;              ///< kClippedOutput: full scale in R; of an axis: degrees.
  int output = -1;                 ///< kStuckOutput: 0, 1, 2 = u, v, w; -1: all three.
};

}  // namespace abcal::sim
