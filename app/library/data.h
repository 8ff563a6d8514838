#pragma once

#include <limits>
#include <map>
#include <string>

#include "abcal/record.h"
#include "abcal/result.h"
#include "protocol/analysis/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal::v1 {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct [[gnu::visibility("hidden")]] Record::Data {
  ::abcal::RunRecord record;
};

struct [[gnu::visibility("hidden")]] Result::Data {
  ::abcal::CalibrationResult result;
  Values sensitivity_matrix, offset, intrinsic_sensitivity, intrinsic_angle;
  Covariance covariance, covariance_intrinsic;
};

// What is hidden here belongs to no interface.

/// The public form of a result.
[[gnu::visibility("hidden")]] Result public_result(::abcal::CalibrationResult result);

/// As RecordSettings::effects: sets sizes by their keys, with the source "stated".
/// @throws std::invalid_argument
[[gnu::visibility("hidden")]] void set_effects(const std::map<std::string, double>& effects,
                                               ::abcal::EffectSizes& sizes);

}  // namespace abcal::v1
