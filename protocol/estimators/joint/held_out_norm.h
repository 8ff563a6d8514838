#pragma once

#include "protocol/estimators/joint/joint_options.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// |a| on poses that the fit did not see (Geist & Gaitan, Metrologia 59, 052101: the magnitude of the
/// calibrated acceleration is g_loc at every orientation). The angles are divided into folds; each fold is
/// predicted by a joint fit of the others.
///
/// A check of the stated uncertainty: no error of the stage is in it to first order, since a turn changes no
/// magnitude. For the same reason it is blind to the orientation of the matrix and to F_X. It is not
/// independent of g_loc, which is the unit of the sensitivities and of |a| alike.
struct HeldOutNorm {
  int folds = 0;  ///< 0: not done.
  int poses = 0;
  /// |a|/g_loc - 1 with the customer's equation a = M (r - b), M and b of the line response.
  double rms = 0.0, largest = 0.0;
  /// The same with the fitted non-linearity and drift of the item, and what the stated uncertainties of
  /// readings and item expect of it.
  double rms_of_model = 0.0, rms_expected = 0.0;
  double rms_in_u = 0.0;     ///< Root mean square of that over its own standard uncertainty: about 1.
  double probability = 1.0;  ///< P(rms_in_u as large), if the stated uncertainties are right.
};

/// @param folds  2 or more
/// @return with folds = 0: the angles of a fold leave too few for a fit
/// @throws UnusableData as fit_item()
HeldOutNorm held_out_norm(const RunRecord& record, const JointOptions& options = {}, int folds = 4);

}  // namespace abcal
