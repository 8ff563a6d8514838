#pragma once

#include <Eigen/Core>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/norm/norm_model.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// One static pose: the readings of the accelerometer at an orientation that need not be known.
struct Pose {
  Eigen::Vector3d reading = Eigen::Vector3d::Zero();  ///< r_u, r_v, r_w (R)
  std::optional<Eigen::Vector3d> u;                   ///< Standard uncertainties (R), greater than 0.
  std::optional<double> t;  ///< Time, -1/2 to 1/2 over the run; absent: evenly in the order given.
  Message name;             ///< "experiment 1, alpha = 5 degrees"; empty: its place in the order.
  /// Mean signs with which the hysteresis acts (ArrivalSigns); absent: those of the changes of the readings.
  std::optional<Eigen::Vector3d> sign{};
  /// Direction of the specific force in the axes of the mount, of length 1; absent: not known.
  std::optional<Eigen::Vector3d> up{};
};

/// Poses this many robust standard deviations from the unit sphere are left out, at most a quarter of all.
inline constexpr double kNormOutlier = 5.0;

/// `sizes` of an item that is linear and does not drift: no effect is estimated.
EffectSizes linear_item(EffectSizes sizes = {});

/// The norm estimator: the specific force has the magnitude g_loc at every pose, so poses alone determine the
/// intrinsic properties (no angles needed, no orientation found): |B (l - O)| = 1 with B the inverse of s up
/// to a rotation, in the gauge where s is upper triangular, and l the readings free of the effects of the
/// item (drift, non-linearity, hysteresis) whose sizes are not zero. The result is the line response. Nine
/// unknowns without a prior.
///
/// With uncertainties on every pose: weights from them, chi2 as the test; where it fails, a common scatter is
/// added until it agrees, and the verdict is doubtful. Without: equal weights, uncertainties from the
/// residuals. A pose is left out where its norm is off by more than kNormOutlier robust standard deviations
/// (1.4826 times the median of |residual|, corrected for the degrees of freedom) and, where uncertainties are
/// stated, by more than kNormOutlier of its own; at most a quarter of the poses. NormResult::left_out lists
/// them with their residuals.
///
/// Where every pose states its direction, two equations more for each direction make three unknowns more, the
/// turn of the item in its mount, and the result has the sensitivity matrix. Five directions are enough. The
/// standard uncertainty of the directions is `u_up`, else the residuals give it, apart from that of the norm.
/// A direction that is kNormOutlier robust standard deviations off makes the result doubtful, and is named.
///
/// Fewer than nine poses need `sizes.orthogonality`: three equations more, of the angles between the axes.
/// Results are in R/g_loc. sphere_coverage is three times the smallest eigenvalue of the directions' scatter
/// matrix (1: even); coverage_words names the largest cap without a pose where it is wider than 60 degrees in
/// radius.
/// @throws UnusableData a reading or uncertainty that is not finite
/// Too few poses, or poses that do not determine the unknowns, give Verdict::kNotUsable and the reason.
CalibrationResult analyse_norm(std::span<const Pose> poses, const EffectSizes& sizes = linear_item(),
                               std::optional<Angle> u_up = {});

/// A solved norm fit, for studies of it. Readings are shifted by `centre` and divided by `size` (R).
struct NormFit {
  std::vector<NormPose> poses;  ///< Those that were used.
  NormModel model;
  NormSolution solution;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double size = 1.0;
  /// Degrees of freedom of the poses' common variance, where the residuals gave it; infinite: it is stated.
  double scatter_degrees = std::numeric_limits<double>::infinity();
  /// The same of the directions' variance.
  double turn_degrees = std::numeric_limits<double>::infinity();
};

/// Every dwell of a record as a pose (closing angles and check poses too: they are poses like any other),
/// with the effects of the item at the sizes of the record.
/// @param fit  if not null, receives the fit of a result that is usable or doubtful
CalibrationResult analyse_norm(const RunRecord& record, std::optional<NormFit>* fit = nullptr);

}  // namespace abcal
