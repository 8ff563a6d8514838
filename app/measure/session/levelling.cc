#include "app/measure/session/levelling.h"

#include <cmath>

#include "app/measure/session/level_plan.h"
#include "app/system/version.h"
#include "protocol/plan/limits.h"

namespace abcal {

std::optional<Eigen::Matrix3d> nominal_sensitivity(const std::string& output_unit, double g_loc_mps2) {
  const auto response = nominal_response({}, output_unit, g_loc_mps2);
  if (!response) return std::nullopt;
  return Eigen::Matrix3d::Identity() * *response;
}

Levelling evaluate_levelling(const StoredRun& run, const Eigen::Matrix3d& sensitivity) {
  const std::vector<DwellRecord>& dwells = run.record.dwells;
  const auto spin_end = dwells.end() - static_cast<std::ptrdiff_t>(kReversalPositions);
  return {tilt_from_spin({dwells.begin(), spin_end}, sensitivity),
          x_zero_from_reversal({spin_end, dwells.end()}, sensitivity, run.record.tolerances)};
}

LevelFile level_file_of(const Levelling& levelling, const StoredRun& run) {
  const auto stored = [](const Quantity& q) { return MeasuredValue{q.value, q.standard_uncertainty}; };
  const TiltOfZ& tilt = levelling.tilt;
  const XZero& x_zero = levelling.x_zero;
  LevelFile level;
  level.utc = run.events.back().utc;
  level.program_version = program_version();
  for (const InstrumentIdentity& instrument : run.header.instruments) {
    if (instrument.role == "stage") level.stage_serial_number = instrument.serial_number;
  }
  level.alignment.zx = stored(tilt.zx);
  level.alignment.zy = stored(tilt.zy);
  level.alignment.xz = {x_zero.zx_plus_xz.value - tilt.zx.value,
                        std::hypot(x_zero.zx_plus_xz.standard_uncertainty, tilt.zx.standard_uncertainty)};
  level.x_zero_deg = stored(x_zero.error);
  level.delta_z = stored(tilt.delta_z);
  return level;
}

}  // namespace abcal
