#pragma once

#include "protocol/estimators/joint/collect_readings.h"

namespace abcal {

/// Completes the readings of sweeps: mean rates, places within the sweep, the item's delay and loss of
/// amplitude (both from the difference of sweeps of one circle at two rates). Moves the angles to those at
/// which the item measured, and reverses the effect of a first-order filter of this loss on the orders 2 to 7
/// of the turn. Readings of a stage at rest are not changed.
/// @throws UnusableData the item's filter does not settle before the first step of a sweep
void account_for_motion(CollectedReadings& data);

}  // namespace abcal
