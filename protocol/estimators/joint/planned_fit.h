#pragma once

#include <Eigen/Core>
#include <optional>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/joint_options.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The uncertainty that the joint fit will have of a run that is planned: the Fisher information of its
/// readings, with the priors of all effects. The derivatives of the readings do not depend on how many are
/// averaged at an angle, so each number of readings costs one factorisation. A record of the stage
/// (RunRecord::stage_record) is the prior of the stage, as in fit_measurement(). The noise is white and of
/// the size that is stated: no noise is searched for, which in a run may find some wandering.
class PlannedFit {
 public:
  /// @param record  the run as it is planned, with the readings of the item free of noise on a stage free of
  /// errors; `u_mean` of each dwell is the standard deviation of a single reading
  /// @throws UnusableData as effect_fit()
  PlannedFit(const RunRecord& record, const JointOptions& options);
  PlannedFit(const PlannedFit&) = delete;
  PlannedFit& operator=(const PlannedFit&) = delete;

  /// The covariance of the line response (s row by row and O, R) where each reading is the mean of this
  /// number, at least 1. The voltmeter is not in it.
  /// @throws UnusableData an unknown that neither the readings nor a prior determine
  Covariance12 covariance_line(double readings);
  /// The line response itself (R).
  Vector12 line() const;

 private:
  /// The stage as a record knows it, with its fine map in front of the unknowns of the model.
  struct KnownStage {
    ReadingRows by_map;     ///< Derivatives of the readings by the fine map (3 N x angles).
    Eigen::MatrixXd prior;  ///< Weights of all priors.
    double step_sd = 0.0;   ///< Size of the part of a step error that a visit does not repeat (radian).
  };
  /// The covariance of the line response with the record, relative units.
  Covariance12 covariance_with_record(const Eigen::Vector3d& white) const;

  CollectedReadings data_;  ///< The model refers to its readings.
  EffectModel model_;
  std::optional<KnownStage> stage_;
};

}  // namespace abcal
