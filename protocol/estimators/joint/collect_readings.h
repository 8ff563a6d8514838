#pragma once

#include <array>
#include <vector>

#include "protocol/estimators/joint/effect_fit.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The readings of a record that the joint fit uses, in the order of the record. Angles that are clipped,
/// stuck or not finite are left out.
struct CollectedReadings {
  std::vector<EffectReading> readings;
  std::vector<const DwellRecord*> dwells;  ///< The dwell of each reading; they live in the record.
  int clipped = 0;
  int stuck = 0;
  int not_finite = 0;
  /// Every reading in use states an uncertainty above zero. If not, `u` is a first guess, the same for all.
  bool u_known = false;
  std::vector<SweepSize> sweeps;  ///< Those of a run at a constant rate, in the order of measurement.
  /// About X and about Z: a first estimate of the delay of the item behind the encoder (s). The angles of the
  /// readings are those that the item saw with this delay.
  std::array<double, 2> delay_s{};
  /// A first estimate of the item's loss of amplitude at 60 degrees/s, the mean over the outputs.
  double loss = 0.0;
};

/// In a run of two faces closing angles and angles of 0 degrees have step errors of any size (step_factor),
/// so that they do not determine the mean zero of the axis.
/// @param one_map_per_axis  readings of one axis at one angle share a step error
/// @throws UnusableData an experiment that is not 1, 2 or 3; a number that is not finite
CollectedReadings collect_readings(const RunRecord& record, bool one_map_per_axis = false);

}  // namespace abcal
