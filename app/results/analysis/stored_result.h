#pragma once

#include <optional>
#include <string>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// The result of an estimator as it is stored with a run, where it needs no second fit: outputs, covariances,
/// published result, gravity and verdict. All else that a fit gives is missing.
///
/// It belongs to the content of the file: the run's results name the SHA-256 of the file as it is, the chain
/// of its analyses is unbroken, and this version of abcal stored it. Nothing is returned on any doubt: other
/// contents, another version, a version whose commit is not known, several items, which have a common fit, a
/// result that is not usable, and a number that is missing.
/// `abcal verify` computes stored results again and never uses them.
/// @param run  as read_if_as_closed() or read_as_stored() has read it
std::optional<CalibrationResult> stored_result(const CheckedRun& run, const std::string& estimator);

}  // namespace abcal
