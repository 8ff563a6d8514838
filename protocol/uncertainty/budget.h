#pragma once

#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/abc_design.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// Source of what the readings themselves show.
inline constexpr const char* kThisRun = "this run";

/// One input of the budget and its effect on every output, to first order (JCGM 100).
struct BudgetLine {
  Message input;             ///< "Zx", "f_1(1..72)", "noise of the readings" ...
  std::string value;         ///< Estimate of the input, as text: "0", "measured".
  std::string unit;          ///< Unit of the input and of its standard uncertainty.
  std::string distribution;  ///< "normal", "rectangular", "triangular", "u-shaped": as it was stated.
  double standard_uncertainty = 0.0;
  /// Change of each output for a change of the input by one unit. For several like inputs (step errors; u, v,
  /// w of the readings) the root of the sum of squares. NaN if only the contribution is known.
  OutputVector sensitivity = OutputVector::Zero();
  OutputVector contribution = OutputVector::Zero();  ///< Standard uncertainty it causes in each output.
  /// The same where sensitivities are per m/s2 (R/(m/s2)); offsets and angles as in `contribution`. NaN where
  /// g_loc is not known. Per standard g (9.80665 m/s2, exact) all are that many times larger.
  OutputVector contribution_per_mps2 = OutputVector::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Degrees of freedom of each contribution; infinite for a stated value. Together they give those of the
  /// result (Welch-Satterthwaite).
  OutputVector degrees_of_freedom = OutputVector::Constant(std::numeric_limits<double>::infinity());
  std::string key;  ///< Key of its size in the bench file; empty: it has none.
  /// Source of the standard uncertainty: as stated, "default", kThisRun or kStageRecordSource.
  std::string source;
  bool type_a = false;            ///< From the scatter of readings.
  bool is_local_gravity = false;  ///< The line of g_loc.
};

struct Budget {
  std::vector<BudgetLine> lines;
  OutputVector combined = OutputVector::Zero();  ///< Root of the sum of squares of the contributions.
  /// The same of contribution_per_mps2: for sensitivities in SI units and per standard g.
  OutputVector combined_per_mps2 = OutputVector::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Due to the inputs that Monte Carlo draws.
  OutputCovariance type_b_covariance = OutputCovariance::Zero();
  OutputCovariance covariance = OutputCovariance::Zero();  ///< Due to all lines.
  /// Covariance of s row by row and O due to everything but the inputs that Monte Carlo draws (alignment,
  /// turns, zeros, steps): readings, resolution, all other effects.
  Covariance12 other_covariance = Covariance12::Zero();
  /// How a Monte Carlo of the published protocol becomes one of the whole budget: its errors of s and O (e)
  /// become (1 + by_correction) e plus normal errors with added_covariance. by_correction is the part of the
  /// correction for k2 and k3 that goes with e, added_covariance all that does not: the rest of that
  /// correction, and other_covariance.
  Covariance12 by_correction = Covariance12::Zero();
  Covariance12 added_covariance = Covariance12::Zero();
  std::vector<Message> not_covered;  ///< Sources that no line represents; part of every budget.
  std::vector<std::string> notes;

  double share(const BudgetLine& line, int output) const;  ///< Share of the variance of an output, 0..1.
  /// As share(), of the output in SI units or per standard g. NaN where g_loc is not known.
  double share_per_mps2(const BudgetLine& line, int output) const;
};

/// The budget of an ABC, joint or norm result (NaN: elements of a matrix that it does not have). Its combined
/// uncertainty is that of the result. The covariances for Monte Carlo are filled for ABC alone.
/// @param record      with the tolerances to be used
/// @param result      analyse_abc, analyse_joint or analyse_norm of this record
/// @param resolution  smallest step of the output (R), if known; of an ABC result
/// @throws std::invalid_argument for a result without numbers, a record without enough angles
Budget make_budget(const RunRecord& record, const CalibrationResult& result,
                   std::optional<double> resolution = {});

}  // namespace abcal
