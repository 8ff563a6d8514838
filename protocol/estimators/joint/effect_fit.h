#pragma once

#include <Eigen/Core>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/estimators/shared/noise_process.h"
#include "protocol/model/arrival.h"
#include "protocol/model/effects.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// One triple of readings for the fit with all effects, in the order of time.
struct EffectReading {
  int experiment = 0;  ///< 1, 2, 3
  double sin_alpha = 0.0, cos_alpha = 1.0;
  double t = 0.0;                                   ///< -1/2 to 1/2 over the run.
  Eigen::Vector3d value = Eigen::Vector3d::Zero();  ///< r_u, r_v, r_w (R)
  Eigen::Vector3d u = Eigen::Vector3d::Zero();      ///< Their standard uncertainties (R).
  int map = -1;  ///< One step error for all readings with the same number; -1: one of its own.
  int face = 1;  ///< 1 or 2 (protocol/plan/faces.h).
  /// Its step error of its own is this times an unknown of the size `step_deg` (collect_readings.h).
  double step_factor = 1.0;
  // Where the stage turns: of the axis that moves, and the number of its sweep in EffectFitOptions::sweeps.
  double rate_radps = 0.0;
  double acceleration_radps2 = 0.0;
  double mean_rate_radps = 0.0;  ///< The mean over the sweep.
  int sweep = -1;                ///< -1: at rest.
  double turned_rad = 0.0;       ///< Since the middle of the sweep.
  Arrival arrival{};             ///< The motions by which the stage reached this angle.
};

/// Knowledge of the angles of one sweep, as standard deviations (radian).
struct SweepSize {
  double mean = 0.0;    ///< Size of an error that is common to its angles.
  double course = 0.0;  ///< Size of the error's course around the circle, rms of each part (sweep_shares()).
};

/// The signs of the hysteresis that a fit takes at each reading (ItemPoint::came_from). A change D of the
/// response with the standard uncertainty u has the sign 1 with the probability Phi(D/u).
struct HysteresisSigns {
  std::vector<Eigen::Vector3d> mean;      ///< Mean sign for u, v, w, -1 to 1.
  std::vector<Eigen::Vector3d> variance;  ///< Variance of the reading that its unknown sign causes; relative.
};

struct EffectFitOptions {
  EffectSizes sizes;
  MeasuredAlignment measured_alignment;
  bool nonlinearity = true;   ///< false: k2 and k3 are zero exactly.
  bool drift = true;          ///< false: no drift of offset and sensitivity.
  bool mean_step = true;      ///< false: F_X = F_Z = 0 exactly; for studies.
  bool noise_process = true;  ///< false: the noise is white.
  bool white_known = true;    ///< false: u is a first guess; the white noise of each output is estimated.
  std::optional<HysteresisSigns> signs = std::nullopt;  ///< Absent: those of the solution.
  std::vector<SweepSize> sweeps{};                      ///< Those of a run at a constant rate.
  /// S_j (R), the relative unit, so that runs of one item have one. Absent: that of the linear solution.
  std::optional<Eigen::Vector3d> unit = std::nullopt;
};

/// One unknown of the fit, in relative units: quantities of an output are divided by its S_j.
struct EffectUnknown {
  std::string effect;  ///< "wobble of X"; "s", "O" (no prior)
  std::string name;    ///< "wobble of X, cos 1/rev, direction 2"; "drift u, of order 1"
  std::string key;     ///< Key of its size; "s", "O": empty.
  int output = -1;     ///< 0, 1, 2 = u, v, w; -1: an unknown of the stage.
  double prior_mean = 0.0;
  double prior_sd = std::numeric_limits<double>::infinity();
};

/// The noise that the fit found.
struct NoiseFound {
  double process_probability = 0.0;  ///< Posterior probability of a process; prior: 1/2.
  double tau = 0.0;  ///< Standard deviation of the most probable process, in units of u; 0: white.
  double rho = 0.0;  ///< Its correlation length, in angles.
  Eigen::Vector3d white = Eigen::Vector3d::Ones();  ///< White standard deviation over the u given.
  bool white_estimated = false;
};

/// How much better the readings are explained if a stated size is larger.
struct SizeEvidence {
  std::string key;     ///< Key of the size; "step_deg, step_smooth_deg": both.
  double times = 0.0;  ///< Factor by which it is larger.
  /// Logarithm of the ratio of the readings' densities, each averaged over the noises. If the statement is
  /// right the ratio exceeds 1/p with a probability below p for any noise (Markov's inequality: its mean is
  /// 1).
  double log_ratio = 0.0;
};

struct EffectFit {
  bool converged = false;
  int iterations = 0;
  std::vector<EffectUnknown> unknowns;
  Eigen::VectorXd value;                           ///< Values of the unknowns, relative units.
  Eigen::MatrixXd covariance;                      ///< Covariance of the unknowns.
  Eigen::Vector3d unit = Eigen::Vector3d::Ones();  ///< S_j (R): the relative unit.

  /// The measurand: s row by row and O of the line response, in R (R/g_loc).
  Eigen::Matrix<double, 12, 1> line = Eigen::Matrix<double, 12, 1>::Zero();
  Covariance12 covariance_line = Covariance12::Zero();
  Covariance12 covariance_line_type_b = Covariance12::Zero();  ///< The part due to the priors.
  std::vector<EffectShare> shares;                             ///< Contributions to covariance_line_type_b.
  Eigen::Matrix<double, 12, 1> degrees_of_freedom =
      Eigen::Matrix<double, 12, 1>::Constant(std::numeric_limits<double>::infinity());
  /// Derivative of the line response (R) by every reading (R): 3 N x 12, rows u, v, w of each angle.
  ReadingRows gain;
  NoiseFound noise;
  /// With D = whitened_jacobian covariance_root, H = D D' is the share of the fit in the whitened readings:
  /// their residuals have the covariance I - H. The root is upper triangular.
  ReadingRows whitened_jacobian;
  Eigen::MatrixXd covariance_root;
  /// The unknowns of the effects that are stated as zero, and the whitened readings' derivatives by them.
  std::vector<EffectUnknown> left_out;
  ReadingRows left_out_design;

  /// Filled where a noise process was found, which may in fact be an effect larger than stated. Else empty.
  std::vector<SizeEvidence> larger_sizes;

  double chi2 = std::numeric_limits<double>::quiet_NaN();  ///< Priors included.
  int chi2_degrees_of_freedom = 0;                         ///< Readings - 12.
  double reciprocal_condition = 0.0;
  std::vector<double> step_error;          ///< f of each reading (radian), without mean and smooth part.
  std::vector<double> u_step_error;        ///< radian
  std::vector<double> step_factor;         ///< EffectReading::step_factor of each reading.
  std::vector<Eigen::Vector3d> residuals;  ///< Reading minus model, step error included (R).
  std::vector<Eigen::Vector3d> whitened;   ///< Residuals whitened by the noise found; of variance ~ 1.
};

/// The joint estimator with every effect of protocol/model/effects.h (docs/theory). Damped steps (minimise())
/// from the linear solution at a perfect stage; step errors without memory are eliminated. An effect whose
/// size is zero is left out. The noise process is averaged over a grid of (tau, rho) by its restricted
/// likelihood, with a prior probability of 1/2 for no process; its mean over the run belongs to the offset.
/// @throws UnusableData the readings do not determine the sensitivity matrix, or the noise where it is asked
/// for; an output is dead; a size or a measured value that is not a finite number >= 0
/// @throws std::invalid_argument no readings; a reading that is not finite; u not > 0
EffectFit effect_fit(std::span<const EffectReading> readings, const EffectFitOptions& options);

}  // namespace abcal
