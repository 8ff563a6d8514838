#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_solution.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// Information of readings as a quadratic form of unknowns q,
///   chi2(q) = (q - at)' weight (q - at) - 2 pull'(q - at) + squares.
struct ReadingsForm {
  Eigen::MatrixXd weight;
  Eigen::VectorXd pull;
  double squares = 0.0;
  double log_determinant = 0.0;  ///< That of the readings' covariance.
};

/// Information of the readings of one item in one run on the item and the stage: a quadratic form of
/// q = the outputs' own unknowns, the unknowns of the stage, those of its sweeps, and the step error of each
/// visit (radian). It holds the readings alone: no prior of these unknowns. The model is linear at `at`, the
/// solution of the item's own fit, which is nearer to the truth than an error of second order (1e-8) shows.
struct RunInformation {
  std::string source;                   ///< The run, for messages.
  EffectSizes sizes;                    ///< Stated with the run.
  EffectLayout layout;                  ///< Own unknowns, then those of the stage.
  std::vector<EffectUnknown> unknowns;  ///< As the layout has them.
  std::vector<AxisAngle> visits;        ///< Angles of the axis that moves, reading by reading.
  std::vector<int> experiments;         ///< 1, 2, 3, reading by reading.
  std::vector<double> step_factors;     ///< EffectReading::step_factor, reading by reading.
  /// The stage turned at constant rates: a visit is a reading of a sweep, whose step error is of its own.
  bool in_motion = false;
  Eigen::Vector3d unit = Eigen::Vector3d::Ones();  ///< S_j (R): the relative unit.
  Eigen::VectorXd at;
  ReadingsForm form;
  int readings = 0;  ///< Single outputs' readings.

  /// Relative rows of s, for u, v, w, at the solution of the item's own fit.
  Eigen::Matrix3d rows() const;
};

/// The noise of an item's readings in a run, of those that its own fit finds probable.
enum class RunNoise {
  /// For one run, where the measurement weighs the probable noises again and averages over them.
  kMostProbable,
  /// For one of several: a process whose variance is the mean over the probable noises, so that what is not
  /// known of the noise is in the uncertainty.
  kMean,
};

/// @param data  the readings of the solution
/// @throws std::invalid_argument a solution that did not converge; one whose readings share step errors
RunInformation run_information(const CollectedReadings& data, const EffectSolution& solution,
                               RunNoise noise = RunNoise::kMostProbable);

/// The mean of the probable noises: white noise and process have the mean of their variances, and the process
/// the correlation length at which that variance lies in the mean.
AssumedNoise mean_noise(const EffectSolution& solution);

/// The form at another noise, about the same point.
ReadingsForm form_at(const EffectModel& model, const AssumedNoise& noise);

/// Index of the most probable noise of an item's own fit.
std::size_t best_noise(const EffectSolution& solution);

}  // namespace abcal
