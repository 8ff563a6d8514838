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
  /// As that of analyse_joint(), with the stage estimated from all items of the common fit. The tests are
  /// those of the item's own readings. An item outside the common fit has the result of its own fit.
  CalibrationResult result;
  bool in_common_fit = false;
  Message why_not;            ///< Why it is not in the common fit; empty if it is.
  std::vector<Check> checks;  ///< Checks of its record (check_record).
  /// Increase of chi2 by its readings, over that of the other items alone; NaN where it was not tested.
  double chi2_given_others = std::numeric_limits<double>::quiet_NaN();
  int degrees_of_freedom = 0;
  double probability = std::numeric_limits<double>::quiet_NaN();  ///< P(increase as large) if all agree.
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
  /// Error of the angle turned, minus the mean error over the experiment's angles: smooth and other step
  /// errors together, degree. It hardly depends on the priors.
  Quantity angle_error;
};

/// The stage, from all items of the common fit.
struct TrayStage {
  int items = 0;
  std::vector<StageQuantity> unknowns;
  std::vector<StageStep> steps;     ///< In the order of measurement; empty if their size is zero.
  std::vector<EffectTest> effects;  ///< Tests of the effects against their stated sizes.
  std::vector<Message> contradicted_sizes;
};

/// Order: the twelve outputs of Covariance12, then s_u, s_v, s_w, phi_uv, phi_vw, phi_wu (degree).
using Covariance18 = Eigen::Matrix<double, 18, 18>;

/// The result of a run with one item or several.
struct TrayResult {
  Verdict verdict = Verdict::kNotUsable;
  Message why{"not analysed"};
  std::vector<TrayItemResult> items;  ///< In the order of the records.
  std::optional<TrayStage> stage;     ///< Absent for a single item, unless the options ask for it.
  int iterations = 0;                 ///< Iterations of the common fit.

  /// Covariance of the outputs of item i (rows) with those of item k (columns), from 0. Zero where it is not
  /// known because one of two items is not in the common fit.
  Covariance12 covariance(std::size_t i, std::size_t k) const;
  Covariance18 covariance_of_all_outputs(std::size_t i, std::size_t k) const;

  /// Covariance of the outputs of the items of the common fit, 12 for each item in the order of the items.
  Eigen::MatrixXd common_covariance;
};

/// The joint analysis of the items, one or several, that were measured in one run on one stage
/// (docs/theory/series.md). The stage is estimated once from all of them. Every item is first analysed on its
/// own, and its noise is that of its own fit. An item that is doubtful on its own is set aside, so that it
/// does not spoil the others, as long as one is usable; so is one that contradicts the others about the
/// stage. One item alone gives the result of analyse_joint().
/// @param records  one for each item; their order is that of the result
/// @throws std::invalid_argument no records; records that state different sizes of the stage's effects;
///         one map of step errors per axis with more than one item; as analyse_joint()
TrayResult analyse_tray(std::span<const RunRecord> records, const JointOptions& options = {});

/// Why each item of these records is evaluated by itself, where they are not fitted together. The step errors
/// of sweeps repeat from sweep to sweep, and the items share them: together they would claim more than they
/// know.
std::optional<Message> why_each_by_itself(std::span<const RunRecord> records);
/// Why an item that is doubtful on its own is not fitted with others.
Message doubtful_on_its_own();

/// Fills the verdict on the tray and its reason from the results of the items; call it again if one changes.
void judge_tray(TrayResult& tray);

/// Compares the intrinsic properties of two items of a common fit (item k minus item i). Errors of the stage,
/// which they share, cancel.
/// @throws std::invalid_argument an item that is not in the common fit
IntrinsicComparison compare_items(const TrayResult& tray, std::size_t i, std::size_t k);

}  // namespace abcal
