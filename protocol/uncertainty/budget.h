#pragma once

#include <optional>
#include <string>
#include <vector>

#include "protocol/analysis/calibration_result.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/abc_design.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// One input of the budget and what it does to every output, to first order (JCGM 100).
struct BudgetLine {
  std::string input;         ///< "Zx", "f_1(1..72)", "noise of the readings" ...
  std::string value;         ///< Estimate of the input, as text: "0", "measured".
  std::string unit;          ///< Of the input and of its standard uncertainty.
  std::string distribution;  ///< "normal", "rectangular"
  double standard_uncertainty = 0.0;
  /// Change of each output for a change of the input by one unit. Of several like inputs (step errors; u, v,
  /// w of the readings) the root of the sum of squares. NaN where the contribution is known and not the
  /// sensitivity.
  OutputVector sensitivity = OutputVector::Zero();
  OutputVector contribution = OutputVector::Zero();  ///< Standard uncertainty it causes in each output.
  bool type_a = false;                               ///< From the scatter of readings.
};

struct Budget {
  std::vector<BudgetLine> lines;
  OutputVector combined = OutputVector::Zero();  ///< Root of the sum of squares of the contributions.
  OutputCovariance type_b_covariance = OutputCovariance::Zero();  ///< Of the inputs that Monte Carlo draws.
  OutputCovariance covariance = OutputCovariance::Zero();         ///< Of all lines.
  /// Of the same inputs, by the ABC equations alone: what a Monte Carlo of the published protocol finds.
  OutputCovariance published_type_b_covariance = OutputCovariance::Zero();
  /// Covariance of s row by row and O due to everything but the inputs that Monte Carlo draws (alignment,
  /// turns, zeros, steps): readings, resolution, all other effects.
  Covariance12 other_covariance = Covariance12::Zero();
  /// What a Monte Carlo of the whole budget adds to the published protocol's: other_covariance, and what the
  /// correction for k2 and k3 makes of the inputs that are drawn.
  Covariance12 added_covariance = Covariance12::Zero();
  std::vector<std::string> not_covered;  ///< What no line stands for; part of every budget.
  std::vector<std::string> notes;

  double share(const BudgetLine& line, int output) const;  ///< Of the variance of an output, 0..1.
};

/// The budget of an ABC result.
/// @param record      with the tolerances to be used
/// @param result      analyse_abc of this record
/// @param resolution  smallest step of the output (R), if known
/// @throws std::invalid_argument for a result without numbers, a record without enough angles
Budget make_budget(const RunRecord& record, const CalibrationResult& result,
                   std::optional<double> resolution = {});

}  // namespace abcal
