#pragma once

#include <vector>

#include "protocol/analysis/joint_fit.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// What the joint fit takes of a record: angles that are clipped, stuck or not finite are left out.
struct JointData {
  std::vector<JointReading> readings;
  std::vector<const DwellRecord*> dwells;  ///< As the readings; they live in the record.
  int clipped = 0;
  int stuck = 0;
  int not_finite = 0;
  bool u_known = false;  ///< Every reading in use states an uncertainty above zero.
};

/// @param one_map_per_axis  see JointOptions; else the readings are in the order of the record
/// @throws UnusableData an experiment that is not 1, 2 or 3; a number that is not finite
JointData collect_joint_data(const RunRecord& record, bool one_map_per_axis);

/// Noise of each accelerometer from the residuals: u is repeated until the weighted squares of the residuals
/// equal their expectation (variance component estimation). Returns the fit with it; `readings` keep the u
/// found.
JointFit fit_with_unknown_noise(std::vector<JointReading>& readings, const JointPriors& priors,
                                const JointModel& model);

}  // namespace abcal
