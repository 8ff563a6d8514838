#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "protocol/estimators/measurement/measurement_result.h"
#include "protocol/uncertainty/budget.h"
#include "protocol/uncertainty/gum_validation.h"
#include "protocol/uncertainty/monte_carlo.h"
#include "protocol/uncertainty/study_output.h"
#include "protocol/uncertainty/type_a.h"

namespace abcal {

/// Trials of the ABC result unless others are asked for. JCGM 101: at least 1e4/(1 - p).
inline constexpr std::uint64_t kAbcTrials = 200'000;

struct UncertaintyOptions {
  std::optional<std::uint64_t> trials = kAbcTrials;  ///< Absent: adaptive to `digits`.
  int digits = 2;                                    ///< Digits for the adaptive run.
  int validation_digits = 1;  ///< Meaningful digits of u in the validation of the GUM framework.
  std::uint64_t seed = 1;
  unsigned threads = 0;
  std::optional<double> resolution;  ///< Step of the output (R).
  bool paper_preset = false;         ///< Section 5's bounds as the type B uncertainty.
  MonteCarloTeam* team = nullptr;    ///< Other processes that share the work.
  std::stop_token stop;
  std::function<void(std::uint64_t done, std::uint64_t planned)> progress;
};

/// @throws std::invalid_argument  fewer than two trials
void require_trials(const UncertaintyOptions& options);
MonteCarloOptions monte_carlo_options(const UncertaintyOptions& options);

/// An output whose Monte Carlo contradicts the uncertainty that the result states.
struct StudyDifference {
  int output = 0;            ///< As in study_output.h.
  std::string of;            ///< "standard uncertainty", "half 95.45 % interval"
  double monte_carlo = 0.0;  ///< u, or half the length of the interval.
  double stated = 0.0;       ///< u of the result, or its U.
};

/// Monte Carlo of the joint or norm result, compared with the result's statements.
struct JointComparison {
  OutputVector standard_uncertainty = OutputVector::Zero();  ///< As the result states it.
  OutputVector expanded = OutputVector::Zero();              ///< With k for its degrees of freedom.
  std::vector<StudyDifference> differences;                  ///< Above kNamedDifference.
  int solved_in_full = 0;  ///< Trials that were solved again by the estimator itself.
  int not_converged = 0;   ///< Those of them without a solution.
  /// Root mean square over these trials of the difference of the two solutions, in u: of the worst output.
  double largest_deviation = 0.0;
};

/// A difference between Monte Carlo and a stated uncertainty above this share is named.
inline constexpr double kNamedDifference = 0.1;

/// Text for readers: what the Monte Carlo of the joint result can show.
inline constexpr const char* kWhatIsChecked =
    "Each trial draws every effect from its stated distribution and the noise from its fitted model, makes "
    "the readings of the fitted item and applies the whole estimator to them. It checks linearity and the "
    "shapes of the distributions. It does not check the model.";

/// Trials of the joint estimator unless others are asked for: 95 % intervals to some 2 % of their length.
inline constexpr std::uint64_t kJointTrials = 10'000;

/// The uncertainty of one run's result.
struct RunUncertainty {
  std::string estimator = "abc";  ///< "abc", "joint", "norm"
  std::string source;
  std::string response_unit;
  Tolerances tolerances;
  std::uint64_t seed = 1;
  CalibrationResult result;   ///< That of the estimator.
  StudyOutput value;          ///< Its 18 outputs; NaN: those of the matrix that norm does not have.
  MonteCarloResult type_b;    ///< ABC: errors due to the calibration system.
  MonteCarloResult type_a;    ///< ABC: values, by the paper's section 6. Zero trials: interrupted before.
  std::string acs_measured;   ///< The record of the stage in the type A evaluation, by SHA-256; empty: none.
  MonteCarloResult combined;  ///< Errors due to the whole budget.
  Budget budget;
  std::vector<GumValidation>
      validation;  ///< Validation of `combined` against the budget, output by output; may be empty.
  OutputVector standard_uncertainty =
      OutputVector::Zero();  ///< Combined: Monte Carlo, or the preset with type A.
  StudyOutput bounds;        ///< Section 5's bounds for this accelerometer.
  bool paper_preset = false;
  std::optional<JointComparison> joint;  ///< For a joint or norm result.
  std::string no_trials;                 ///< Why no Monte Carlo was made; empty: it was.
  std::vector<std::string> warnings;
  bool interrupted = false;
};

/// For the ABC result: type B by Monte Carlo with the record's tolerances, type A, the budget, and both
/// combined.
/// @throws std::invalid_argument for options and tolerances out of range
/// @throws std::runtime_error if the run cannot be analysed
RunUncertainty run_uncertainty(const RunRecord& record, const UncertaintyOptions& options);

/// For the joint result: its budget, and Monte Carlo of the whole estimator (protocol/uncertainty/
/// joint_trials.h), which checks that the estimator is linear enough and its distributions normal enough for
/// the stated uncertainty. It draws from the model of the fit, so it cannot check the model. The options
/// measured, resolution and paper_preset are not used.
/// @throws as run_uncertainty()
RunUncertainty joint_uncertainty(const RunRecord& record, const UncertaintyOptions& options);

/// For the result of the norm estimator: its budget, and Monte Carlo of the whole fit, every trial solved in
/// full. The options measured, resolution and paper_preset are not used.
/// @throws as run_uncertainty()
RunUncertainty norm_uncertainty(const RunRecord& record, const UncertaintyOptions& options);

/// Trials of a common fit unless others are asked for: each solves every item of every run in full.
inline constexpr std::uint64_t kCommonFitTrials = 1'000;

/// The items of a common fit, run by run.
struct CommonFit {
  std::span<const RunRecord> records;
  std::span<const ItemInRun> places;  ///< Items are numbered from 0 in the order of their first runs.
  int item = 0;                       ///< The one that is asked for.
};

/// For a joint result that comes from a common fit of several items or runs, or from a run with a record of
/// its stage: its budget, and Monte Carlo of the whole evaluation, each trial solved in full
/// (measurement_trials.h). The options resolution and paper_preset are not used.
/// @param result  that of the item, by this fit
/// @throws as run_uncertainty(); std::runtime_error  a trial without a solution
RunUncertainty common_fit_uncertainty(const CommonFit& fit, const CalibrationResult& result,
                                      const UncertaintyOptions& options);

}  // namespace abcal
