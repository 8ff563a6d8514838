#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "protocol/model/sweep_angle.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {

/// The readings of one item within one step about an angle that the stage passed.
struct SweepBin {
  std::vector<Reading> readings;
  Clock::Instant middle;                             ///< When the stage was at the angle.
  Eigen::Vector3d value = Eigen::Vector3d::Zero();   ///< At the angle itself, R.
  Eigen::Vector3d u = Eigen::Vector3d::Zero();       ///< Its standard uncertainty from the noise, R.
  Eigen::Vector3d spread = Eigen::Vector3d::Zero();  ///< That of one reading of the sweep, R.
};

/// Distributes the readings of a sweep to its angles. The value of a bin is that of a curve through all
/// readings of the sweep (mean and orders 1 to 8 of the turn) at the angle, and the mean distance of the
/// bin's readings from the curve: so the curvature within a bin does not shift it. Its noise is that of all
/// readings of the sweep about the means of their bins, autocorrelation included, across the direction in
/// which an error of the angle moves the outputs.
/// @param angles  of the sweep, in their order
/// @param readings  in the order of time; those outside all bins are left out, and those that are not finite
/// @return one for each angle; one without readings has no value
std::vector<SweepBin> bins_of_sweep(std::span<const PlannedAngle> angles, Angle step,
                                    const SweepAngle& turned, std::span<const Reading> readings);

}  // namespace abcal
