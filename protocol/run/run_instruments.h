#pragma once

#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/tolerances.h"

namespace abcal {

/// Reopens ports of a run that vanished: a cable was unplugged, or a hub was reset.
class Reconnector {
 public:
  virtual ~Reconnector() = default;
  /// Whether the stage is one of those that are gone.
  virtual bool stage_lost() const = 0;
  /// Opens the lost ports, with new drivers that have not identified their instruments yet.
  /// @throws InstrumentError kCannotOpen, kLinkLost: not back yet; what is back stays open.
  virtual void reconnect() = 0;
  /// Whether the accelerometer of one of several items is gone.
  virtual bool item_lost(int /*item*/) const { return false; }
  /// reconnect() no longer tries to open this item's port.
  virtual void give_up_item(int /*item*/) {}
};

/// One of several items on the stage.
struct ItemInstrument {
  int k = 1;  ///< As in the run file.
  Accelerometer* accelerometer = nullptr;
  LimitsConfig limits;
  Tolerances tolerances;
  ExpectedItem expected;
};

/// The instruments of a run, and their clock.
struct RunInstruments {
  RotationStage& stage;
  Accelerometer& accelerometer;
  Clock& clock;
  Reconnector* reconnector = nullptr;   ///< Null: a port that vanishes ends the run.
  std::vector<ItemInstrument> items{};  ///< Those to be measured; empty: `accelerometer` is the only one.
};

}  // namespace abcal
