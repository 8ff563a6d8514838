#pragma once

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// Whether an output has so few degrees of freedom that its coverage factor is not the common one.
bool own_coverage_factors(const CalibrationResult& result);

}  // namespace abcal
