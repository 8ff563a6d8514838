#pragma once

#include <vector>

#include "protocol/model/stage_model.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// Part of an input of the stage at a pose: a coefficient of an unknown of a state.
struct StageTerm {
  int input = 0;           ///< StageInput
  Eigen::Index place = 0;  ///< Place of the unknown in the state.
  double coefficient = 0.0;
};

/// The inputs of the stage at a pose by the named unknowns of a state, without its fine map.
std::vector<StageTerm> terms_at(const StageState& state, const StagePose& pose);

/// R of the covariance R R' of a state: errors of the stage are its mean and R times independent standard
/// normal numbers.
/// @throws std::invalid_argument a covariance with a direction of less than no variance
Eigen::MatrixXd root_of_covariance(const StageState& state);

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
