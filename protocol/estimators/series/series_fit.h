#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/series/run_information.h"
#include "protocol/record/stage_record.h"

namespace abcal {

/// One run of a series.
struct SeriesRun {
  const RunInformation* information = nullptr;
  int item = 0;  ///< Number of its item, from 0 without a gap.
};

struct SeriesOptions {
  /// The stage as it is known before, with what it does not repeat. Absent: from the sizes that the runs
  /// state.
  std::optional<StageState> stage = std::nullopt;
  std::optional<Repeatabilities> repeatabilities = std::nullopt;
  /// false: what the stage does not repeat is taken as given, not estimated from these runs.
  bool estimate_repeatabilities = true;
  /// Standard deviation of the small turn of an item between two mountings, about each axis (radian).
  double mounting_sd = 0.5 * std::numbers::pi / 180.0;
};

/// One run, from all runs of a series.
struct SeriesRunResult {
  /// Its unknowns as its RunInformation lists them, then the step error of each visit (radian): the stage as
  /// it was in this run, and the item as it was mounted in it.
  Eigen::VectorXd value;
  Eigen::MatrixXd covariance;
  /// How the item is mounted, against its first run in the series: one of the 24 turns of a cube. A vector v
  /// of the item in its first run is now turn v, in the frame of the platter.
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  /// Further small turn after that (radian), about the axes of the platter; zero in the first run.
  Eigen::Vector3d small_turn = Eigen::Vector3d::Zero();
  Eigen::Matrix3d small_turn_covariance = Eigen::Matrix3d::Zero();
  /// "as in the first run"; "turned by 90 degrees about X".
  std::string mounting() const;
};

/// The item from all runs of a series.
struct SeriesItem {
  EffectLayout layout;                             ///< Its unknowns, without those of a single run (drift).
  Eigen::Vector3d unit = Eigen::Vector3d::Ones();  ///< S_j (R)
  Eigen::VectorXd value;                           ///< Relative units.
  Eigen::MatrixXd covariance;
  /// The line response as it is mounted in its first run, s row by row and O (R).
  Vector12 line = Vector12::Zero();
  Covariance12 covariance_line = Covariance12::Zero();
  /// Contributions of the priors to it, by effect; the rest is the noise of the readings.
  std::vector<EffectShare> shares;
};

struct SeriesFit {
  bool converged = false;
  int iterations = 0;
  std::vector<SeriesItem> items;
  std::vector<SeriesRunResult> runs;
  StageState stage;  ///< From these runs and what was known before.
  Repeatabilities repeatabilities{};
  double chi2 = 0.0;            ///< For all readings, priors included.
  int degrees_of_freedom = 0;   ///< Readings - 12 for each item.
  double log_likelihood = 0.0;  ///< Density of the readings, up to a constant of theirs.
  double reciprocal_condition = 0.0;
};

/// One fit of several runs on one stage: runs of one item in several mountings, or of several items
/// (docs/theory/series.md). Common to the runs are the stage, with a fine map of each axis, and each item.
/// Each run has its own drifts, its own small turn of the item, the step error of each visit, and what the
/// stage does not repeat of its zeros, alignment and initial turns.
/// @throws UnusableData runs whose stated sizes of the stage differ; an item that is not turned by one of
/// the 24 turns of a cube
/// @throws std::invalid_argument no runs; units of an item that differ
SeriesFit fit_series(std::span<const SeriesRun> runs, const SeriesOptions& options = {});

}  // namespace abcal
