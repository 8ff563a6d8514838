#pragma once

#include <cstdint>

#include "protocol/model/alignment.h"
#include "protocol/record/run_record.h"
#include "protocol/uncertainty/monte_carlo.h"

namespace abcal {

/// Measured properties of the calibration system, for the type A evaluation of the paper's section 6.
struct MeasuredAcs {
  AcsErrors mean;            ///< Measured alignment, turn, mean step and step errors.
  AcsErrors standard_error;  ///< Standard errors of these means, in the same fields.

  /// Nothing measured: means of zero, the tolerances as standard errors.
  static MeasuredAcs not_measured(const RunRecord& record);
};

/// Type A evaluation (paper, section 6; docs/theory/uncertainty.md): every trial draws the system's errors
/// around their measured means and fits s and O of the measured readings to the forward model with these
/// errors. The response is linear in s and O once the errors are given, so a trial is one 4 x 4 solve and no
/// search. Outputs are the 18 values (not errors); their means and standard deviations are the result and its
/// type A standard uncertainty due to the system.
/// @throws std::invalid_argument for standard errors that are negative or not finite; a record without enough
/// readings
MonteCarloResult run_type_a(const RunRecord& record, const MeasuredAcs& measured, std::uint64_t seed,
                            const MonteCarloOptions& options);

}  // namespace abcal
