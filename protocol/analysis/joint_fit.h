#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "protocol/analysis/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// Whether k2 and k3 are unknowns of the fit.
enum class Nonlinearity {
  kFitted,
  kLeftOut,  ///< Zero exactly; for studies.
};

struct JointOptions {
  Nonlinearity nonlinearity = Nonlinearity::kFitted;
  bool drift = true;              ///< false: no drift, of offset and of sensitivity.
  bool mean_step = true;          ///< false: F_X = F_Z = 0 exactly; for studies, not for measurements.
  bool one_map_per_axis = false;  ///< f depends on axis and angle alone: experiments 1 and 2 share it.
  bool noise_process = true;      ///< false: the noise is white; for studies.
  MeasuredAlignment measured_alignment;
};

/// The joint estimator (docs/joint_estimator.md): the line response of the item, with every effect of
/// protocol/model/effects.h that the record's sizes give a width as an unknown of one fit. The sensitivity
/// matrix of the result is, as everywhere, the one at rest in the LGCS at the default orientation (already
/// tilted with Z). `type_a` of a result is the part of its posterior variance that comes from the readings'
/// noise, `type_b` the part that comes from the priors.
///
/// Weights are 1/u_mean^2; where a dwell has none, or zero, the noise of each accelerometer is estimated from
/// the residuals of the fit, and chi2 is absent. Dwells with kFlagClipped or kFlagNotFinite and a mean that
/// is not finite are left out and counted in the notes.
/// @throws std::invalid_argument a size or measured uncertainty that is not finite or below zero, or zero for
/// alignment, initial turn, zero or step;
///         a reading that is not finite without its flag; an experiment number that is not 1, 2 or 3
CalibrationResult analyse_joint(const RunRecord& record, const JointOptions& options = {});

// ---- The fit itself, for studies: arrays in, numbers out. -----------------------------------------------

/// The unknowns that stay when the step errors have been eliminated. For accelerometer j: 7 j + (s_jx, s_jy,
/// s_jz, O_j, b_j, k2_j, k3_j); then Zx, Zy, Xz, d2, d3, F_X, F_Z (1 and radian).
constexpr int kOwnUnknowns = 7;
constexpr int kGeometryUnknowns = 7;
constexpr int kJointUnknowns = 3 * kOwnUnknowns + kGeometryUnknowns;
using JointVector = Eigen::Matrix<double, kJointUnknowns, 1>;
using JointMatrix = Eigen::Matrix<double, kJointUnknowns, kJointUnknowns>;

enum JointUnknown : int {
  kOffsetIndex = 3,  ///< + 7 j
  kDriftIndex = 4,
  kK2Index = 5,
  kK3Index = 6,
  kZx = 21,
  kZy = 22,
  kXz = 23,
  kD2 = 24,
  kD3 = 25,
  kFX = 26,
  kFZ = 27,
};

/// One triple of readings.
struct JointReading {
  int experiment = 0;  ///< 1, 2, 3
  double sin_alpha = 0.0, cos_alpha = 1.0;
  double t = 0.0;                                   ///< -1/2 to 1/2 over the run.
  Eigen::Vector3d value = Eigen::Vector3d::Zero();  ///< r_u, r_v, r_w (R)
  Eigen::Vector3d u = Eigen::Vector3d::Zero();      ///< Their standard uncertainties (R).
  int step_error = 0;  ///< Which step error belongs to it; consecutive from 0, in ascending order.
};

/// Means and standard deviations of the priors. Angles in radian.
struct JointPriors {
  /// Zx, Zy, Xz, d2, d3, F_X, F_Z.
  Eigen::Matrix<double, kGeometryUnknowns, 1> mean = Eigen::Matrix<double, kGeometryUnknowns, 1>::Zero();
  Eigen::Matrix<double, kGeometryUnknowns, 1> sd = Eigen::Matrix<double, kGeometryUnknowns, 1>::Zero();
  double step = 0.0;
  double drift = 0.0;  ///< times S_j
  double k2 = 1e-2;    ///< over S_j (docs/theory/joint_estimator.md, table of unknowns)
  double k3 = 1e-2;    ///< over S_j^2

  /// What is stated as zero gets a prior of 1e-9: it is known exactly.
  /// @throws UnusableData a size or a measured value that is not a finite number, or is below zero
  static JointPriors from(const Tolerances& tolerances, const MeasuredAlignment& measured = {});
};

/// Which of the optional unknowns are in the fit.
struct JointModel {
  bool nonlinearity = true;
  bool drift = true;
  bool mean_step = true;
};

struct JointFit {
  bool converged = false;
  int iterations = 0;
  JointVector value = JointVector::Zero();                 ///< R, R/g_loc, 1/R, 1/R^2, radian
  JointMatrix covariance = JointMatrix::Zero();            ///< Posterior; zero rows where left out.
  JointMatrix covariance_type_b = JointMatrix::Zero();     ///< The part of it that comes from the priors.
  std::vector<double> step_error;                          ///< radian
  std::vector<double> u_step_error;                        ///< radian
  double chi2 = std::numeric_limits<double>::quiet_NaN();  ///< Priors included.
  int degrees_of_freedom = 0;                              ///< Readings - 12.
  double reciprocal_condition = 0.0;  ///< Of the 28 (or fewer) scaled unknowns' normal matrix, square root.
  Eigen::Vector3d sum_weighted_squares = Eigen::Vector3d::Zero();  ///< Of the residuals, per accelerometer.
  Eigen::Vector3d redundancy = Eigen::Vector3d::Zero();            ///< Their expectation if `u` is right.
  std::vector<Eigen::Vector3d> residuals;  ///< Reading minus model (R), as the readings.
};

/// Gauss-Newton from the linear solution at a perfect stage (which on three full circles is the ABC solution
/// up to the weights). Step errors are eliminated by a Schur complement: each touches only its own readings.
/// Internally every accelerometer's readings are divided by its S_j and unknowns are scaled by their
/// diagonal, so that a result in LSB is the same result.
/// @param with_residuals  also fill residuals, sum_weighted_squares and redundancy
/// @throws std::invalid_argument no readings, a number that is not finite, u or a prior's sd not > 0
/// @throws UnusableData the readings do not determine the sensitivity matrix, or one output is dead
JointFit joint_fit(std::span<const JointReading> readings, const JointPriors& priors, const JointModel& model,
                   bool with_residuals = false);

/// One triple of the model's readings and their derivatives, in the units of `value`.
struct JointModelPoint {
  Eigen::Vector3d reading;                              ///< R
  Eigen::Matrix<double, 3, kJointUnknowns> by_unknown;  ///< In the order of JointVector.
  Eigen::Vector3d by_step_error;                        ///< R/radian
};

/// The model at one angle, for the test of its derivatives against central differences.
/// @param step_error  f, radian
JointModelPoint joint_model(const JointReading& at, const JointVector& value, double step_error);

}  // namespace abcal
