#pragma once

#include "protocol/estimators/joint/collect_readings.h"

namespace abcal {

/// Completes the readings of sweeps: mean rates, places within the sweep, the item's delay and loss of
/// amplitude (both from the difference of sweeps of one circle at two rates). Turns the angles to those that
/// the item saw, and takes back what a first-order filter of this loss does to the orders 2 to 7 of the turn.
/// Nothing changes in readings of a stage that stands.
/// @throws UnusableData the item's filter does not settle before the first step of a sweep
void account_for_motion(CollectedReadings& data);

}  // namespace abcal
