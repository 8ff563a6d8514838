#pragma once

#include <stop_token>
#include <string>
#include <vector>

#include "app/measure/session/bench_check.h"

namespace abcal {

/// The item that was on the bench before.
struct ItemBefore {
  std::string serial_number;  ///< Serial number as people know it; empty: not known.
  std::string reported;       ///< Serial number that the instrument reported.
};

/// Whether an item is the requested one, and is mounted as the bench file states.
struct ItemCheck {
  std::vector<Finding> findings;
  std::string reported;  ///< The serial number that the instrument reports; may be empty.

  /// Whether no finding is a problem.
  bool passed() const;
};

/// Identifies the accelerometer and reads it at rest, at the present position of the stage: its identity, its
/// noise, and whether gravity is along the axis that `mounting` states. Nothing moves.
/// @param config  with the item that is expected
/// @throws RunInterrupted; an instrument that fails is a finding
ItemCheck check_mounted_item(Bench& bench, const BenchConfig& config, const ItemBefore& before,
                             const std::stop_token& stop);

/// Judges the identity. @param simulated  the instrument reports the same number whichever item is mounted
Finding judge_identity(const std::string& wanted, const std::string& reported, const ItemBefore& before,
                       bool simulated);

/// Judges the mounting by one reading at rest. @param mounting  as in the bench file: "x y z"
Finding judge_mounting(const PoseReading& pose, const std::string& mounting);

}  // namespace abcal
