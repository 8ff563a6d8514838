#pragma once

#include <cstdint>

#include "protocol/record/run_record.h"
#include "protocol/record/stage_record.h"
#include "protocol/uncertainty/monte_carlo.h"

namespace abcal {

/// The calibration system as the type A evaluation of the paper's section 6 draws it.
struct MeasuredAcs {
  /// Errors of the stage at the time of the run with their covariances, including what differs from run to
  /// run of its zeros, alignment and initial turns.
  StageState state;
  Angle repeatability;  ///< Standard deviation of the step error of a visit from the map of the state.
  Angle step;           ///< Standard deviation of a step error at an angle that the map does not have.

  /// Nothing measured: means of zero, the sizes that the run states as standard deviations.
  static MeasuredAcs not_measured(const RunRecord& record);
  /// As the record of the stage has it.
  /// @param months  from its last learning to the run
  static MeasuredAcs of(const StageRecord& record, double months);
};

/// How a trial of the type A evaluation draws.
enum class TypeADraw {
  /// The sums of its fit, where all standard deviations are at most kMostSummedTypeADegrees; else each error.
  kSums,
  kEachError,  ///< The reference.
};
/// Above it (degrees) the squares of errors change the sums by more than 0.15 % of what the errors do.
inline constexpr double kMostSummedTypeADegrees = 0.1;

/// Type A evaluation (paper, section 6; docs/theory/uncertainty.md): every trial draws the system's errors
/// around their measured means and fits s and O of the measured readings to the forward model with these
/// errors. The response is linear in s and O once the errors are given, so a trial is one 4 x 4 solve and no
/// search. The errors act through the 18 sums of that solve alone. They are normal, and so are the sums, to
/// first order: a trial draws the sums. Outputs are the 18 values (not errors); their means and standard
/// deviations are the result and its type A standard uncertainty due to the system.
/// @throws std::invalid_argument a covariance that is not one; a record without enough readings
MonteCarloResult run_type_a(const RunRecord& record, const MeasuredAcs& measured, std::uint64_t seed,
                            const MonteCarloOptions& options, TypeADraw draw = TypeADraw::kSums);

}  // namespace abcal
