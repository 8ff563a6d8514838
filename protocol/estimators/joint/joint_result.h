#pragma once

#include <string>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The result for one item.
/// @param common  its fit from all items of a common fit; nullptr: its own fit only
CalibrationResult joint_result(const RunRecord& record, const ItemFit& own,
                               const EffectFit* common = nullptr);

/// factor * value, with its standard uncertainty. @param factor  above 0
Quantity scaled_quantity(double value, double variance, double factor, std::string unit);

}  // namespace abcal
