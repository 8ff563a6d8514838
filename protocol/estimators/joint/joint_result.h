#pragma once

#include <string>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The result for one item.
/// @param common  what the fit of several items says of it; nullptr: its own fit is all there is
CalibrationResult joint_result(const RunRecord& record, const ItemFit& own,
                               const EffectFit* common = nullptr);

/// factor * value, with its standard uncertainty. @param factor  above 0
Quantity scaled_quantity(double value, double variance, double factor, std::string unit);

}  // namespace abcal
