#pragma once

#include <Eigen/Core>
#include <optional>

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

}  // namespace abcal
