#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <numbers>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "drivers/text/message.h"
#include "protocol/estimators/measurement/run_information.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// One item in one run of a measurement.
struct MeasuredItem {
  const RunInformation* information = nullptr;
  int item = 0;  ///< Number of the item, from 0 in the order of their first runs.
  int run = 0;   ///< Number of the run, from 0 without a gap.
  /// For each reading the number of the stage's pose in the run: the items of a run share its step error.
  /// Empty: the number of the reading.
  std::vector<int> pose = {};
  /// Its own fit. With it, a measurement of one run chooses the noise of each item again and averages over
  /// the probable ones; in several runs the noise is that of `information`, as without. With it the mean of
  /// the noise process over the runs belongs to the offset.
  const EffectSolution* own = nullptr;
};

struct MeasurementOptions {
  /// The stage as it is known before, with what it does not repeat. Absent: from the sizes that the runs
  /// state.
  std::optional<StageState> stage = std::nullopt;
  std::optional<Repeatabilities> repeatabilities = std::nullopt;
  /// false: what the stage does not repeat is taken as given, not estimated from these runs.
  bool estimate_repeatabilities = true;
  /// false: the measurement is one run without a record, and the stage is wanted as it was in this run: a
  /// step error has all of its stated size at each pose, and no part of it repeats elsewhere.
  bool separates_what_repeats = true;
  /// Standard deviation of the small turn of an item between two mountings, about each axis (radian).
  double mounting_sd = 0.5 * std::numbers::pi / 180.0;
};

/// One item in one run, from the whole measurement.
struct InRunFit {
  /// Its unknowns as its RunInformation lists them, then the step error of each visit (radian): the stage as
  /// it was in this run, and the item as it was mounted in it.
  Eigen::VectorXd value;
  Eigen::MatrixXd covariance;
  /// How the item is mounted, against its first run in the measurement: one of the 24 turns of a cube. A
  /// vector v of the item in its first run is now turn v, in the frame of the platter.
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  /// Further small turn after that (radian), about the axes of the platter; zero in the first run.
  Eigen::Vector3d small_turn = Eigen::Vector3d::Zero();
  Eigen::Matrix3d small_turn_covariance = Eigen::Matrix3d::Zero();
  /// "as in the first run"; "turned by 90 degrees about X".
  Message mounting() const;
};

/// One item, from the whole measurement.
struct FittedItem {
  std::size_t first = 0;  ///< Place among the measured items of its first run.
  /// The line response as it is mounted in its first run, s row by row and O (R), averaged over the probable
  /// noises; the offset contains the mean of the noise process over the runs.
  Vector12 line = Vector12::Zero();
  Covariance12 covariance_line = Covariance12::Zero();
  /// Contributions of the priors to it, by effect; the rest is the noise of the readings.
  std::vector<EffectShare> shares;
  /// In a measurement of one run with the item's own fit: as in EffectFit.
  std::optional<Vector12> degrees_of_freedom;
  ReadingRows gain;
  /// Increase of chi2 by the item's readings over that of the others alone. If the model is right it has a
  /// chi2 distribution with the degrees of freedom of the item's own fit. Of one run; NaN otherwise.
  double chi2_given_others = std::numeric_limits<double>::quiet_NaN();
};

struct MeasurementFit {
  bool converged = false;
  int iterations = 0;
  std::vector<FittedItem> items;
  std::vector<InRunFit> in_runs;     ///< In the order in which the items of the runs are given.
  Eigen::MatrixXd covariance_lines;  ///< 12 outputs for each item: their line responses (R).
  StageState stage;                  ///< From these runs and what was known before.
  Repeatabilities repeatabilities{};
  /// In one run: the stage's unknowns as they were in it (`stage.names`), then the step error of each pose
  /// that its items share, in the order of the poses.
  Eigen::VectorXd poses;
  Eigen::MatrixXd covariance_poses;
  double chi2 = 0.0;            ///< For all readings, priors included.
  int degrees_of_freedom = 0;   ///< Readings - 12 for each item.
  double log_likelihood = 0.0;  ///< Density of the readings, up to a constant of theirs.
  double reciprocal_condition = 0.0;
};

/// Variance of the fine map at an angle of which nothing is known before (radian^2). `step_deg` is the size
/// of a step error: the part that repeats is what is left of it by the part that does not. Where the axis has
/// its zero its error is minus its mean, F, and its smooth part, so that the map is free.
/// @param step   size of a step error (radian)
/// @param visit  its part that differs from visit to visit (radian)
double variance_of_new_map(const AxisAngle& angle, double step, double visit);

/// One fit of all readings of a measurement: one run or several on one stage, of one item or several
/// (docs/theory/series.md). What two readings share follows from the owner of an unknown: the stage, with a
/// fine map of each axis; an item; a run (what the stage does not repeat of its zeros, alignment and initial
/// turns, errors of its sweeps); an item in a run (drifts, its small turn, delays); a pose (its step error).
/// Least squares in information form by block elimination: of one run the items first, so that the cost grows
/// linearly with their number; of several runs those first. Stage and what is left are solved last.
/// @throws UnusableData runs whose stated sizes of the stage differ; an item that is not turned by one of
/// the 24 turns of a cube
/// @throws std::invalid_argument no runs; units of an item that differ
MeasurementFit fit_measurement(std::span<const MeasuredItem> measured,
                               const MeasurementOptions& options = {});

/// A truth that a measurement allows before its readings.
struct MeasurementTruth {
  /// For each item in each run the values of its unknowns, as MeasuredItem::information lists them: the last
  /// are the step errors of the visits.
  std::vector<Eigen::VectorXd> in_runs;
  /// For each item the line response as it is mounted in its first run (R). The mean of a noise process is
  /// not in it.
  std::vector<Vector12> lines;
};

/// A fit of a measurement and truths around it, for trials (JCGM 101). Sensitivities, offsets and mountings
/// of a truth are those of the fit; every other unknown is drawn from what is known of it before the
/// readings: the record of the stage with its covariance, stated sizes, and what the fit found of the parts
/// that the stage does not repeat.
class MeasurementTruths {
 public:
  /// @param measured  must outlive this
  /// @throws as fit_measurement()
  explicit MeasurementTruths(std::span<const MeasuredItem> measured, const MeasurementOptions& options = {});
  ~MeasurementTruths();

  const MeasurementFit& fit() const;
  /// @param standard  draws a value of mean 0 and standard deviation 1 for an unknown whose size has this
  /// key;
  ///                  an empty key: normal
  MeasurementTruth draw(const std::function<double(const std::string& key)>& standard) const;

 private:
  struct Solved;
  std::unique_ptr<Solved> solved_;
};

}  // namespace abcal
