#pragma once

#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// What is asked of the record, whatever the estimator: temperature, drift, the changes of change_scan.h, and
/// the sensitivities, when those changes are accounted for, against the nominal one (unit, full scale).
std::vector<Check> check_record(const RunRecord& record);

/// Enters them in the result's diagnostics, with what is asked of the result itself: the directions of its
/// outputs against the mounting (and its sensitivities, where the record was too short to be examined). What
/// failed makes a usable result doubtful and stands first in `why` and in the notes.
void apply_checks(std::vector<Check> of_the_record, const RunRecord& record, CalibrationResult& result);

}  // namespace abcal
