#pragma once

#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Checks of the record, independent of the estimator: temperature, stuck outputs, check poses, drift, the
/// changes of change_scan.h, and the sensitivities without those changes (unit, full scale).
std::vector<Check> check_record(const RunRecord& record);

/// Enters the checks of the record in the result's diagnostics, with those of the result itself: directions
/// of the outputs against the mounting (and sensitivities, where check_record() did not check them). A failed
/// check makes a usable result doubtful and is first in `why` and in the notes.
void apply_checks(std::vector<Check> of_the_record, const RunRecord& record, CalibrationResult& result);

}  // namespace abcal
