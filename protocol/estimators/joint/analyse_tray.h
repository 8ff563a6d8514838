#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/checks/comparison.h"
#include "protocol/estimators/joint/joint_options.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// One item of a run.
struct TrayItemResult {
  /// As that of analyse_joint(), with the stage as all items of the common fit show it. The tests are those
  /// of the item's own readings. An item outside the common fit has the result of its own fit.
  CalibrationResult result;
  bool in_common_fit = false;
  std::string why_not;        ///< Why it is not in the common fit; empty if it is.
  std::vector<Check> checks;  ///< Of its record (check_record).
  /// By how much its readings raise chi2 above that of the other items alone; NaN where it was not asked.
  double chi2_given_others = std::numeric_limits<double>::quiet_NaN();
  int degrees_of_freedom = 0;
  double probability = std::numeric_limits<double>::quiet_NaN();  ///< If all agree about the stage.
};

/// One unknown of the stage.
struct StageQuantity {
  std::string effect;  ///< "wobble of X"
  std::string name;    ///< "wobble of X, cos 1/rev, direction 2"
  Quantity value;      ///< 1, degree, urad
};

/// The step error of the stage at one of its angles.
struct StageStep {
  int experiment = 0;
  int n = 0;
  DwellRole role = DwellRole::kPlan;
  Quantity value;  ///< Without mean and smooth part, degree.
  /// By how much more it turned than on the average of the experiment's angles, beyond what was commanded:
  /// smooth and other step errors together, degree. What the angles tell, whatever the priors.
  Quantity angle_error;
};

/// The stage, from all items of the common fit.
struct TrayStage {
  int items = 0;
  std::vector<StageQuantity> unknowns;
  std::vector<StageStep> steps;     ///< In the order of measurement; empty if their size is zero.
  std::vector<EffectTest> effects;  ///< Each against its stated size.
  std::vector<std::string> contradicted_sizes;
};

/// Of one item: the twelve outputs of Covariance12, then s_u, s_v, s_w, phi_uv, phi_vw, phi_wu (degree).
using Covariance18 = Eigen::Matrix<double, 18, 18>;

/// The result of a run with one item or several.
struct TrayResult {
  Verdict verdict = Verdict::kNotUsable;
  std::string why = "not analysed";
  std::vector<TrayItemResult> items;  ///< In the order of the records.
  std::optional<TrayStage> stage;
  int iterations = 0;  ///< Of the common fit.

  /// Covariance of the outputs of item i (rows) with those of item k (columns), from 0. Zero where it is not
  /// known because one of two items is not in the common fit.
  Covariance12 covariance(std::size_t i, std::size_t k) const;
  Covariance18 covariance_of_all_outputs(std::size_t i, std::size_t k) const;

  /// Between the outputs of the items of the common fit, 12 of each in the order of the items.
  Eigen::MatrixXd common_covariance;
};

/// The joint analysis of the items, one or several, that were measured in one run on one stage
/// (docs/theory/tray.md). The stage is estimated once from all of them. Every item is first analysed on its
/// own, and its noise is that of its own fit. An item that is doubtful on its own is set aside, so that it
/// does not spoil the others, as long as one is usable; so is one that contradicts the others about the
/// stage. One item alone gives the result of analyse_joint().
/// @param records  one of each item; their order is that of the result
/// @throws std::invalid_argument no records; records that state different sizes of the stage's effects;
///         one map of step errors per axis with more than one item; as analyse_joint()
TrayResult analyse_tray(std::span<const RunRecord> records, const JointOptions& options = {});

/// The verdict on the tray, and why, from the results of its items: once more where one of them has changed.
void judge_tray(TrayResult& tray);

/// Whether two items of a common fit have the same intrinsic properties (item k less item i). What they
/// share, the stage, cancels.
/// @throws std::invalid_argument an item that is not in the common fit
IntrinsicComparison compare_items(const TrayResult& tray, std::size_t i, std::size_t k);

}  // namespace abcal
