#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "protocol/analysis/calibration_result.h"
#include "protocol/model/alignment.h"
#include "protocol/record/run_record.h"

namespace abcal {

struct AnalysisOptions {
  /// Smallest step of the output (R): adds step/sqrt(12) to each reading as type B. Absent: not known, left
  /// out.
  std::optional<double> resolution;
};

/// The plain ABC result (paper, Eqs. 5-10; physics.md section 3) of a record, with type A from the readings
/// and first-order type B from the record's tolerances, diagnostics and a verdict. Closing angles are left
/// out of the fits. A record that cannot be analysed gives Verdict::kNotUsable and the reason in `why`, and
/// no numbers.
CalibrationResult analyse_abc(const RunRecord& record, const AnalysisOptions& options = {});

/// What one input quantity that is known by its tolerance does to the twelve outputs of analyse_abc().
struct OutputEffect {
  std::string name;  ///< As in InputEffect: "Zx", "d2", "F_X", "f_1(3)", "drift u".
  Eigen::Matrix<double, 12, 1>
      change;  ///< Of the outputs (order of Covariance12) for one standard uncertainty.
};

/// The type B effects whose squares make covariance_type_b (without resolution), one for each input whose
/// tolerance is not zero: for covariances between results that have inputs in common.
/// @throws std::invalid_argument a record that analyse_abc() would refuse; the message is its reason
std::vector<OutputEffect> type_b_effects(const RunRecord& record);

}  // namespace abcal
