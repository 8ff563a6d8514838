#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/noise_search.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// One drawn world of a JointTrials: the truth, and the readings that it gives. Relative units.
struct JointDraw {
  Eigen::VectorXd value;                   ///< The unknowns of the fit.
  std::vector<double> steps;               ///< Step errors without memory, of each reading (radian).
  std::vector<Eigen::Vector3d> came_from;  ///< Signs for the hysteresis, of the responses that were drawn.
  Eigen::VectorXd noise;                   ///< 3 N: white noise and process.
  Eigen::Vector3d process_mean = Eigen::Vector3d::Zero();  ///< Mean of the process over the run: part of O.
  Vector12 by_voltmeter = Vector12::Zero();                ///< Its error in s row by row and O (R).
};

/// Trials of the joint estimator for Monte Carlo (JCGM 101): each draws all effects from their stated
/// distributions and the noise from its fitted model, makes the readings of the fitted item by the whole
/// model, and applies the estimator to them. Errors are estimate minus the truth that was drawn.
///
/// operator() applies the estimator with the derivatives at the solution of the run: two steps of
/// minimisation from the truth on the model's exact readings, then the average over the noises by their
/// likelihoods, as in effect_fit(). solved_in_full() calls effect_fit() itself.
///
/// The hysteresis acts with the signs of the responses that were drawn; the estimator takes the mean signs at
/// its own solution (HysteresisSigns), with the uncertainties that the responses have in the run.
///
/// The noise: a process (tau, rho) with its posterior probability; white noise of Student's distribution
/// where the uncertainty of a reading is from the scatter of a dwell; where the fit estimated its size, that
/// is drawn for each output. All trials depend on seed and number alone.
class JointTrials {
 public:
  /// @param own  a solution; it must outlive this
  JointTrials(const ItemFit& own, const RunRecord& record, std::uint64_t seed);

  /// A TrialBlock: errors of the 18 outputs; angles in degrees.
  void operator()(std::uint64_t first, std::size_t count, double* out) const;

  /// The error of the same trial by effect_fit(). NaN where it does not converge.
  OutputVector solved_in_full(std::uint64_t trial) const;

  JointDraw draw(std::uint64_t trial) const;

 private:
  /// The estimator, linear at the solution of the run, at one noise.
  struct Linear {
    AtNoise at;
    double constant = 0.0;      ///< Log-likelihood without its chi2.
    Eigen::MatrixXd root;       ///< R of the covariance of the unknowns, R R'.
    Eigen::MatrixXd line_root;  ///< Unknowns x 12: R' times the derivatives of the line response.
    ReadingRows mean_weights;   ///< 3 N x 3, of the process mean; empty without a process.
  };
  /// Results that a batch of trials (columns) gives at one noise.
  struct BatchAnswer {
    Eigen::RowVectorXd log_likelihood, chi2;
    Eigen::MatrixXd line;  ///< 12 x trials
  };
  class Batch;

  void add(const NoiseCandidate& candidate);
  Vector12 truth_of(const JointDraw& draw) const;
  Eigen::VectorXd readings_of(const JointDraw& draw) const;
  OutputVector error_of(const JointDraw& draw, const Vector12& line) const;
  void draw_effects(RandomStream& stream, JointDraw& draw) const;
  void draw_noise(RandomStream& stream, JointDraw& draw) const;

  const ItemFit& own_;
  const EffectModel& model_;
  EffectSizes sizes_;
  std::uint64_t seed_;
  std::vector<Eigen::Index> hysteresis_;  ///< Numbers of its unknowns; empty: not fitted.
  NoiseQuestion question_;
  Vector12 units_;                        ///< R of each output for one relative unit.
  Vector12 result_;                       ///< The line response of the run (R), for the voltmeter's share.
  std::vector<Eigen::Vector3d> degrees_;  ///< Degrees of freedom of each reading's u.
  Eigen::VectorXd prior_mean_;
  std::vector<Shape> shapes_;   ///< One for each unknown.
  AtNoise start_;               ///< At the noise of the minimisation.
  Eigen::MatrixXd start_root_;  ///< Root of the covariance of the unknowns there.
  std::vector<NoiseAtAngle> start_angles_;
  std::map<NoiseCandidate, Linear> linear_;
};

/// Degrees of freedom of the uncertainty that a dwell's scatter gives its means: the effective number of
/// readings less one. Infinite where it is not known (CSV), 3 at least (JCGM 101, 6.4.9.4: fewer have no
/// standard deviation); 0 where the resolution governs, so that the error is rectangular.
Eigen::Vector3d degrees_of_dwell(const DwellRecord& dwell);

}  // namespace abcal
