#pragma once

#include <stop_token>
#include <string>
#include <vector>

#include "app/operate/session/bench_check.h"

namespace abcal {

/// The item that was on the bench before.
struct ItemBefore {
  std::string serial_number;  ///< As people call it; empty: none is known.
  std::string reported;       ///< As the instrument itself said.
};

/// Whether an item is the one that was asked for, and is mounted as the bench file says.
struct ItemCheck {
  std::vector<Finding> findings;
  std::string reported;  ///< The serial number that the instrument reports; may be empty.

  /// Nothing speaks against starting.
  bool passed() const;
};

/// Asks the accelerometer who it is, and reads it at rest, where the stage stands: its identity, its noise,
/// and whether gravity is along the axis that `mounting` says. Nothing moves.
/// @param config  with the item that is expected
/// @throws RunInterrupted; an instrument that fails is a finding
ItemCheck check_mounted_item(Bench& bench, const BenchConfig& config, const ItemBefore& before,
                             const std::stop_token& stop);

/// Judges the identity. @param simulated  the instrument reports the same whatever is mounted
Finding judge_identity(const std::string& wanted, const std::string& reported, const ItemBefore& before,
                       bool simulated);

/// Judges the mounting by one reading at rest. @param mounting  as in the bench file: "x y z"
Finding judge_mounting(const PoseReading& pose, const std::string& mounting);

}  // namespace abcal
