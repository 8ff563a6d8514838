#pragma once

#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The dwell at an angle of the plan, with the members that are known before the measurement.
inline DwellRecord planned_dwell(const PlannedAngle& angle) {
  DwellRecord dwell;
  dwell.experiment = angle.experiment;
  dwell.n = angle.n;
  dwell.closing = angle.closing;
  if (angle.check) dwell.role = DwellRole::kCheck;
  dwell.alpha = angle.alpha;
  dwell.commanded_x = angle.x;
  dwell.commanded_z = angle.z;
  dwell.face = angle.face;
  if (angle.sweep > 0) dwell.motion = DwellMotion{angle.sweep, angle.rate_deg_per_s};
  return dwell;
}

}  // namespace abcal
