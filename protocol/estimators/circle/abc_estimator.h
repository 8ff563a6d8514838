#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/model/alignment.h"
#include "protocol/record/run_record.h"

namespace abcal {

struct AnalysisOptions {
  /// Smallest step of the output (R): adds step/sqrt(12) to each reading as type B. Absent: not known, left
  /// out.
  std::optional<double> resolution;
};

/// The ABC result (paper, Eqs. 5-10) of a record, always corrected for k2 and k3 as its own harmonics show
/// them, so that it is the line response of the item, with type A from the readings and first-order type B
/// from every effect of protocol/model/effects.h, diagnostics and a verdict. Closing angles are left
/// out of the fits. A record that cannot be analysed gives Verdict::kNotUsable and the reason in `why`, and
/// no numbers.
CalibrationResult analyse_abc(const RunRecord& record, const AnalysisOptions& options = {});

/// First-order effect of one input quantity, known by the size of its effect, on the twelve outputs of
/// analyse_abc(): the change of the ABC result (after its correction for k2 and k3) minus the change of the
/// measurand, the line response.
struct OutputEffect {
  std::string name;      ///< As in InputEffect: "Zx", "d2", "F_X", "f_1(3)", "drift u, of order 1".
  std::string group;     ///< As in InputEffect: one line of a budget.
  std::string key;       ///< As in InputEffect: key of its size in the bench file.
  std::string unit;      ///< Unit of the input.
  bool of_item = false;  ///< True: an effect of the item, not of the stage.
  double standard_uncertainty = 0.0;  ///< That of the input, in its unit.
  Eigen::Matrix<double, 12, 1>
      change;  ///< Change of the outputs (order of Covariance12) for one standard uncertainty.
  /// Change by the ABC equations alone, without the correction for k2 and k3: the published protocol.
  Eigen::Matrix<double, 12, 1> published_change;
};

/// Whether an effect is one that the published protocol draws for its type B: alignment, turns, zeros and
/// step errors of the stage (the paper's own sets have exact turns and zeros).
/// @param key  key of its size in the bench file
bool in_published_protocol(std::string_view key);

/// The type B effects whose squares make covariance_type_b (without resolution), one for each input whose
/// size is not zero: for budgets, and for covariances between results that have inputs in common.
/// @throws std::invalid_argument a record that analyse_abc() would refuse; the message is its reason
std::vector<OutputEffect> type_b_effects(const RunRecord& record);

}  // namespace abcal
