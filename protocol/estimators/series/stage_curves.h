#pragma once

#include <vector>

#include "protocol/record/stage_record.h"

namespace abcal {

/// A value of a stage at an angle of one of its axes.
struct StageCurvePoint {
  double angle_deg = 0.0;
  double value = 0.0;                 ///< radian
  double standard_uncertainty = 0.0;  ///< radian
};

/// The error of an axis, less its mean over the angles of its fine map: smooth errors and fine map together,
/// at these angles but 0 degrees.
/// @param axis  'X' or 'Z'
std::vector<StageCurvePoint> angle_error(const StageState& state, char axis);

/// The wobble of an axis about one of the two directions across it, each 5 degrees, less its mean.
/// @param direction  1 or 2 (docs/theory)
std::vector<StageCurvePoint> wobble(const StageState& state, char axis, int direction);

}  // namespace abcal
