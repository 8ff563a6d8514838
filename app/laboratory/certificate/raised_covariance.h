#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// A combination j of the twelve outputs whose variance j' C j shall not be smaller than a least one.
struct LeastVariance {
  std::string name;  ///< Name of the quantity, for messages: "intrinsic_angle_uv".
  Eigen::Matrix<double, 12, 1> gradient = Eigen::Matrix<double, 12, 1>::Zero();  ///< j
  double variance = 0.0;  ///< In the square of the quantity's unit.
};

/// The covariance C + sum of a_k c_k c_k', c_k = j_k / (j_k' j_k), with the a_k that bring each combination
/// to its least variance: every statement that is derived from it has at least the uncertainty that is asked
/// for, and two statements of one quantity have the same. c_k is the smallest change of the outputs that
/// changes the combination by 1, so that no other is raised much with it. Each
/// a_k is 0 or brings its combination exactly to its variance: only what others force on it is in excess.
/// @param covariance  C, symmetric and positive semidefinite; the outputs in one unit (R/g_loc and R)
/// @throws std::invalid_argument  for a combination that no output changes, naming it
Covariance12 raised_covariance(const Covariance12& covariance, const std::vector<LeastVariance>& least);

}  // namespace abcal
