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
  /// Whether the stage is lost.
  virtual bool stage_lost() const = 0;
  /// Opens the lost ports, with new drivers that have not identified their instruments yet.
  /// @throws InstrumentError kCannotOpen, kLinkLost: not all back yet; ports that are back stay open.
  virtual void reconnect() = 0;
  /// Whether the accelerometer of an item is lost.
  virtual bool item_lost(int /*item*/) const { return false; }
  /// reconnect() no longer tries to open this item's port.
  virtual void give_up_item(int /*item*/) {}
};

/// The accelerometer of an item, and how it is judged.
struct ItemInstrument {
  int k = 1;  ///< As in the run file.
  Accelerometer& accelerometer;
  LimitsConfig limits;
  Tolerances tolerances;
  ExpectedItem expected;
};

/// The instruments of a run, and their clock.
struct RunInstruments {
  RotationStage& stage;
  Clock& clock;
  std::vector<ItemInstrument> items;  ///< Those to be measured, at least one.
  bool has_several_items =
      false;  ///< The bench has several items; those that are missing are not in `items`.
  Reconnector* reconnector = nullptr;  ///< Null: a port that vanishes ends the run.
};

}  // namespace abcal
