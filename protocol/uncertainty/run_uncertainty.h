#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "protocol/uncertainty/budget.h"
#include "protocol/uncertainty/gum_validation.h"
#include "protocol/uncertainty/monte_carlo.h"
#include "protocol/uncertainty/study_output.h"
#include "protocol/uncertainty/type_a.h"

namespace abcal {

struct UncertaintyOptions {
  std::optional<std::uint64_t> trials =
      200'000;                ///< Absent: adaptive to `digits`. JCGM 101: at least 1e4/(1 - p).
  int digits = 2;             ///< Digits for the adaptive run.
  int validation_digits = 1;  ///< Meaningful digits of u in the validation of the GUM framework.
  std::uint64_t seed = 1;
  unsigned threads = 0;
  std::optional<MeasuredAcs>
      measured;  ///< For the type A evaluation; absent: nothing measured, tolerances instead.
  std::optional<double> resolution;  ///< Step of the output (R).
  bool paper_preset = false;         ///< Section 5's bounds as the type B uncertainty.
  MonteCarloTeam* team = nullptr;    ///< Other processes that share the work.
  std::stop_token stop;
  std::function<void(std::uint64_t done, std::uint64_t planned)> progress;
};

/// The uncertainty of one run's ABC result.
struct RunUncertainty {
  std::string source;
  std::string response_unit;
  Tolerances tolerances;
  std::uint64_t seed = 1;
  CalibrationResult result;   ///< analyse_abc of the run.
  StudyOutput value;          ///< Its 18 outputs.
  MonteCarloResult type_b;    ///< Errors due to the calibration system.
  MonteCarloResult type_a;    ///< Values, by the paper's section 6. Zero trials: interrupted before.
  bool acs_measured = false;  ///< Measured system errors entered the type A evaluation.
  MonteCarloResult combined;  ///< Errors due to the whole budget.
  Budget budget;
  std::vector<GumValidation>
      validation;  ///< Validation of `combined` against the budget, output by output; may be empty.
  OutputVector standard_uncertainty =
      OutputVector::Zero();  ///< Combined: Monte Carlo, or the preset with type A.
  StudyOutput bounds;        ///< Section 5's bounds for this accelerometer.
  bool paper_preset = false;
  std::vector<std::string> warnings;
  bool interrupted = false;
};

/// Type B by Monte Carlo with the record's tolerances, type A, the budget, and both combined.
/// @throws std::invalid_argument for options and tolerances out of range
/// @throws std::runtime_error if the run cannot be analysed
RunUncertainty run_uncertainty(const RunRecord& record, const UncertaintyOptions& options);

}  // namespace abcal
