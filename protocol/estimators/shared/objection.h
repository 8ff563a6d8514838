#pragma once

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// Makes a usable result doubtful; the words precede the reasons that it had. A result that is not usable
/// stays so.
void object_to(CalibrationResult& result, const Message& words);

}  // namespace abcal
