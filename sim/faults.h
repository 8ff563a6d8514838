#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::sim {

/// What can be made to go wrong on a simulated bench. The first group happens on the wire (FaultyStream), the
/// second in the world (SimBench::inject).
enum class FaultKind {
  // On the wire.
  kSilence,        ///< Nothing comes back.
  kGarbage,        ///< Random bytes come before what comes back.
  kFlippedBits,    ///< One bit of what comes back is wrong.
  kDroppedBytes,   ///< Some bytes of what comes back are missing.
  kSplitFrame,     ///< What comes back comes one byte at a time.
  kLateReply,      ///< What comes back comes later.
  kReplacedReply,  ///< Another text comes back, e.g. a refusal.
  kUnplug,         ///< The port is gone: every call throws kLinkLost.
  kPowerCycle,     ///< As kUnplug, and the instrument is without power: it starts anew when the fault ends.
  // In the world.
  kStuckOutput,     ///< The output stays at the value it had.
  kClippedOutput,   ///< The output clips at a small full scale, and the instrument says so.
  kNotFinite,       ///< The output is NaN.
  kNoOutput,        ///< The accelerometer makes no readings.
  kStalledAxis,     ///< An axis stops on its way and never says that it is done.
  kStopsShort,      ///< Moves end short of their target; the controller says that all is well.
  kLostReference,   ///< The controller forgets the reference of an axis.
  kRefusedMove,     ///< The controller refuses to move.
  kMissedStep,      ///< An axis is off by some degrees, and its encoder does not see it.
  kMovedAxis,       ///< An axis is off by some degrees, as its encoder says.
  kLostController,  ///< The controller of an axis is cut off from its daisy chain: neither hears nor answers.
  kChamberAlarm,    ///< The thermal chamber has an alarm.
  kChamberDoor,     ///< Its door is open.
};

struct FaultDescription {
  FaultKind kind;
  std::string_view name;  ///< As in scripts and on command lines: "silence".
  std::string_view what;  ///< One line for people.
  bool on_the_wire;       ///< Else in the world.
};

/// All kinds, in the order of the enumeration.
const std::vector<FaultDescription>& fault_descriptions();

/// @throws std::invalid_argument naming the known ones.
FaultKind fault_kind(std::string_view name);

/// A fault of the wire and when it happens: from the `at_write`-th write on (1 is the first; a command is one
/// write) or from the instant `at` on, whichever is given; at once if neither is.
struct WireFault {
  FaultKind kind = FaultKind::kSilence;
  std::optional<std::size_t> at_write{};
  std::optional<Clock::Instant> at{};
  std::optional<Clock::Instant> until{};            ///< Ends then; absent: lasts.
  std::optional<std::size_t> for_writes{};          ///< Ends with that many writes answered; absent: lasts.
  std::string text = {};                            ///< kReplacedReply: what comes back instead.
  Clock::Duration delay = std::chrono::seconds(1);  ///< kLateReply: by how much.
};

/// How slow a link is: what comes back comes later by `latency`, and by up to `jitter` more, in order.
struct LinkTiming {
  Clock::Duration latency = Clock::Duration::zero();
  Clock::Duration jitter = Clock::Duration::zero();
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

/// A byte stream on which scripted faults happen. Repeats exactly: its random bytes come from `seed`.
class FaultyStream final : public wire::ByteStream {
 public:
  FaultyStream(std::unique_ptr<wire::ByteStream> inner, Clock& clock, std::vector<WireFault> faults,
               std::uint64_t seed = 1, LinkTiming timing = {});

  void write(std::string_view bytes) override;
  wire::ReceivedBytes read_until(Clock::Instant deadline) override;
  void discard_input() override;
  std::size_t dropped_bytes() const override { return inner_->dropped_bytes(); }
  std::string name() const override { return inner_->name(); }

  /// `power` is told when kPowerCycle begins (false) and ends (true), in the thread that uses the stream; at
  /// its next use of both, if it did not use it meanwhile. A stream without `power` treats kPowerCycle as
  /// kUnplug.
  void on_power(std::function<void(bool on)> power);

  void add(WireFault fault);
  void clear();                           ///< Takes all faults back, those in force and those to come.
  std::size_t writes() const;             ///< How many there have been.
  bool unplugged() const;                 ///< Or without power.
  std::vector<FaultKind> active() const;  ///< In force now.
  std::optional<Clock::Instant> next_due() const;     ///< When held bytes come out; nothing: none are held.
  std::optional<Clock::Instant> next_change() const;  ///< When a fault begins or ends next by its time.

 private:
  struct Held {
    Clock::Instant due;
    std::string bytes;
  };
  const WireFault* active(FaultKind kind) const;
  void throw_if_unplugged();
  void follow_power();
  std::string distort(std::string bytes);
  std::uint64_t draw();

  std::unique_ptr<wire::ByteStream> inner_;
  Clock& clock_;
  std::vector<WireFault> faults_;
  std::uint64_t seed_;
  LinkTiming timing_;
  std::uint64_t draws_ = 0;
  std::size_t writes_ = 0;
  std::size_t replaced_for_write_ = 0;
  std::vector<Held> held_;
  std::function<void(bool)> power_;
  bool powered_ = true;
  Clock::Instant last_look_;  ///< At the power.
  mutable std::recursive_mutex mutex_;
};

}  // namespace abcal::sim
