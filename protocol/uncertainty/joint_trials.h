#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/noise_search.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/drawn_readings.h"
#include "protocol/uncertainty/random_stream.h"
#include "protocol/uncertainty/study_output.h"
#include "protocol/uncertainty/trial_kernels.h"

namespace abcal {

/// From where a trial draws the effects, the sensitivities and the offsets.
enum class TruthFrom {
  kStatedSizes,  ///< Effects from their stated distributions; s and O are those of the fitted item.
  /// All from the distribution that the run leaves: a trial is a truth that the run allows. What was stated
  /// of its effects is drawn again, like the readings: for this truth, with the stated size. Estimates that
  /// rest on a statement would otherwise differ from each of these truths by the same bias.
  kPosterior,
};

/// Trials of the joint estimator for Monte Carlo (JCGM 101): each draws all effects from their stated
/// distributions and the noise from its fitted model, makes the readings of the fitted item by the whole
/// model, and applies the estimator to them. Errors are estimate minus the truth that was drawn.
///
/// operator() applies the estimator with the derivatives at the solution of the run: a step of minimisation
/// from the truth, then the solutions on the model's exact readings there, averaged over the noises by their
/// likelihoods as in effect_fit(). solved_in_full() calls effect_fit() itself.
///
/// The hysteresis acts with the signs of the responses that were drawn; the estimator takes the mean signs at
/// its own solution (HysteresisSigns), with the uncertainties that the responses have in the run.
///
/// The noise is that of DrawnReadings. All trials depend on seed and number alone.
class JointTrials {
 public:
  /// @param own  a solution; it must outlive this
  JointTrials(const ItemFit& own, const RunRecord& record, std::uint64_t seed,
              TruthFrom truth = TruthFrom::kStatedSizes);

  /// A TrialBlock: errors of the 18 outputs; angles in degrees.
  void operator()(std::uint64_t first, std::size_t count, double* out) const;

  /// The error of the same trial by effect_fit(). NaN where it does not converge.
  /// @throws std::logic_error  truths are drawn from the posterior, whose statements effect_fit() does not
  /// take
  OutputVector solved_in_full(std::uint64_t trial) const;

  JointDraw draw(std::uint64_t trial) const;

 private:
  /// The estimator, linear at the solution of the run, at one noise. R is the root of the covariance of the
  /// unknowns, R R'.
  struct Linear {
    std::optional<NoiseWhitener> whitener;
    double constant = 0.0;  ///< Log-likelihood without its chi2.
    bool has_process = false;
    /// Applies to residuals and unknowns less their priors: [R' J' V^-1, -R' P], and below it [c' V^-1, 0]
    /// with the covariance c of the readings with the mean of the process.
    PanelMatrix from_data;
    PanelMatrix root;                             ///< R
    PanelMatrix line;                             ///< 12 rows: the derivatives of the line response times R.
    std::vector<std::array<double, 3>> selected;  ///< Rows of R of the hysteresis, for each column of R.
  };
  class Batch;
  /// The unknowns that the run allows at one of its probable noises.
  struct Posterior {
    Eigen::VectorXd mean;
    Eigen::MatrixXd root;
  };

  void find_posterior();
  Linear linear_at(const AssumedNoise& noise) const;
  void find_by_step();
  Vector12 truth_of(const JointDraw& draw) const;
  OutputVector error_of(const JointDraw& draw, const Vector12& line) const;
  void draw_effects(RandomStream& stream, JointDraw& draw) const;
  void draw_unknowns(const Posterior& posterior, RandomStream& stream, JointDraw& draw) const;
  void draw_steps(RandomStream& stream, JointDraw& draw) const;

  const ItemFit& own_;
  DrawnReadings draws_;
  const EffectModel& model_;
  std::uint64_t seed_;
  std::vector<Eigen::Index> hysteresis_;  ///< Numbers of its unknowns; empty: not fitted.
  double hysteresis_size_ = 0.0;          ///< As stated, relative.
  NoiseQuestion question_;
  Eigen::VectorXd prior_mean_;
  std::vector<Shape> shapes_;  ///< One for each unknown.
  Linear start_;               ///< At the noise of the minimisation.
  PanelMatrix jacobian_;
  Rows12 line_rows_;                      ///< Derivatives of the line response.
  std::vector<Eigen::Vector3d> by_step_;  ///< That of each reading; zero where no step error is eliminated.
  std::vector<Eigen::Vector3d> step_by_residual_;  ///< The step error by the residual that is left.
  std::map<NoiseCandidate, std::size_t> number_of_;
  std::vector<Linear> linear_;        ///< By number.
  std::vector<Posterior> posterior_;  ///< One for each probable noise of the solution; empty: not drawn from.
};

}  // namespace abcal
