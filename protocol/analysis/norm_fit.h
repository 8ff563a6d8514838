#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "protocol/analysis/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// One static pose: what the accelerometer read, at an orientation that need not be known.
struct Pose {
  Eigen::Vector3d reading = Eigen::Vector3d::Zero();  ///< r_u, r_v, r_w (R)
  std::optional<Eigen::Vector3d> u;                   ///< Standard uncertainties (R), greater than 0.
};

/// The norm estimator: the specific force has the magnitude g_loc at every pose, so poses alone determine the
/// intrinsic properties (no angles needed, no orientation found): |B (r - O)| = 1 with B the inverse of s up
/// to a rotation, in the gauge where s is upper triangular. Nine unknowns.
///
/// With uncertainties on every pose: weights from them, chi2 as the test; where it fails, a common scatter is
/// added until it agrees, and the verdict is doubtful. Without: equal weights, uncertainties from the
/// residuals. Poses whose norm is farther than 5 robust standard deviations from 1 are left out (at most a
/// quarter). Results are in R/g_loc. sphere_coverage is three times the smallest eigenvalue of the
/// directions' scatter matrix (1: even); coverage_words names the largest cap without a pose where it is
/// wider than 60 degrees in radius.
/// @throws UnusableData a reading or uncertainty that is not finite
/// Fewer than nine poses, or poses that do not determine the unknowns, give Verdict::kNotUsable and the
/// reason.
CalibrationResult analyse_norm(std::span<const Pose> poses);

/// Every dwell of a record as a pose (closing angles too: they are poses like any other).
CalibrationResult analyse_norm(const RunRecord& record);

}  // namespace abcal
