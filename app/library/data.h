#pragma once

#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "abcal/record.h"
#include "abcal/result.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal::v1 {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct [[gnu::visibility("hidden")]] Record::Data {
  ::abcal::RunRecord record;
};

struct [[gnu::visibility("hidden")]] Result::Data {
  ::abcal::CalibrationResult result;
  std::vector<QuantityGroup> quantities;
  Covariance covariance, covariance_intrinsic;
  std::optional<Published> published;
  std::optional<double> nominal_response;  ///< R for one g_loc, of the item; absent if unknown.
};

// Hidden functions belong to no interface.

/// The public form of a result. @param record  the one that was analysed
[[gnu::visibility("hidden")]] Result public_result(::abcal::CalibrationResult result,
                                                   const ::abcal::RunRecord& record);

/// Sets sizes by their keys, as in RecordSettings::effects, with the source "stated".
/// @throws std::invalid_argument
[[gnu::visibility("hidden")]] void set_effects(const std::map<std::string, double>& effects,
                                               ::abcal::EffectSizes& sizes);

}  // namespace abcal::v1
