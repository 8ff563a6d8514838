#include "protocol/estimators/joint/collect_readings.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <string>
#include <utility>

#include "protocol/estimators/joint/swept_readings.h"
#include "protocol/estimators/shared/arrivals.h"
#include "protocol/estimators/shared/run_time.h"
#include "protocol/estimators/shared/unusable_data.h"

namespace abcal {
namespace {

/// No reading is believed better than this times S_j: a noise-free record stays solvable (in double precision
/// the normal matrix holds the priors down to about 1e-9), and every real accelerometer is far above.
constexpr double kSmallestRelativeUncertainty = 1e-9;
/// First guess of a noise that was not stated, times S_j: the fit replaces it.
constexpr double kGuessedRelativeUncertainty = 1e-5;

/// S_j as the readings show it: half the range, good enough for a floor and a first guess of the noise.
Eigen::Vector3d rough_sensitivity(const std::vector<EffectReading>& readings) {
  Eigen::Vector3d low = readings.front().value;
  Eigen::Vector3d high = low;
  for (const EffectReading& reading : readings) {
    low = low.cwiseMin(reading.value);
    high = high.cwiseMax(reading.value);
  }
  return 0.5 * (high - low);
}

/// Axis and angle of a dwell, modulo 360 degrees and to the microdegree, so that equal angles compare equal.
std::pair<int, long long> pose_of(const DwellRecord& dwell) {
  const double alpha = dwell.alpha.deg();
  const double turn = alpha - 360.0 * std::floor(alpha / 360.0);
  return {dwell.experiment == 3 ? 1 : 0, std::llround(turn * 1e6) % 360'000'000LL};
}

/// In units of `step_deg`: so large that the angle of such a dwell contains no information on the stage.
constexpr double kFreeStep = 100.0;

/// Whether the step error of a dwell is drawn without regard to others. The axis repeats some unknown part of
/// it where it returns: at a closing angle that of the first angle, and at 0 degrees, where a map has its
/// zero, -F in every experiment.
bool is_independent_step(const DwellRecord& dwell) {
  return !dwell.closing && pose_of(dwell).second != 0;
}

/// No angle of a sweep is believed better than this (degree): the encoder of no stage is.
constexpr double kSmallestSweepAngleDeg = 1e-6;

SweepSize size_of(const DwellMotion& motion, const EffectSizes& sizes) {
  const double u = Angle::degrees(std::max(motion.u_angle_deg, kSmallestSweepAngleDeg)).rad();
  return {std::hypot(u, sizes.sweep.rad()), u};
}

}  // namespace

CollectedReadings collect_readings(const RunRecord& record, bool one_map_per_axis) {
  CollectedReadings data;
  const std::vector<double> times = run_time_fractions(record);
  const bool two_faces = has_two_faces(record);
  bool all_known = true;
  std::map<std::pair<int, long long>, int> maps;
  std::map<std::array<int, 3>, int> sweeps;
  for (std::size_t i = 0; i < record.dwells.size(); ++i) {
    const DwellRecord& dwell = record.dwells[i];
    const std::string where =
        fmt::format("{}: experiment {}, n = {}", record.source, dwell.experiment, dwell.n);
    if (dwell.experiment < 1 || dwell.experiment > 3) {
      throw UnusableData(where + ": the joint estimator needs experiments 1, 2 and 3");
    }
    if (!dwell.mean.allFinite()) {
      if ((dwell.flags & kFlagNotFinite) == 0U) {
        throw UnusableData(where + ": the reading is not a finite number");
      }
      ++data.not_finite;
      continue;
    }
    if ((dwell.flags & kFlagClipped) != 0U) {
      ++data.clipped;
      continue;
    }
    if ((dwell.flags & kFlagStuck) != 0U) {
      ++data.stuck;
      continue;
    }
    if (!std::isfinite(dwell.alpha.deg())) {
      throw UnusableData(where + ": the angle is not a finite number");
    }
    if (dwell.u_mean && (!dwell.u_mean->allFinite() || dwell.u_mean->minCoeff() < 0.0)) {
      throw UnusableData(where + ": the uncertainty of the reading is not a finite number >= 0");
    }
    all_known = all_known && dwell.u_mean && dwell.u_mean->minCoeff() > 0.0;
    const SinCos alpha = sincos(dwell.alpha);
    EffectReading reading{dwell.experiment, alpha.sin, alpha.cos, times[i], dwell.mean};
    reading.face = dwell.face;
    if (two_faces && !is_independent_step(dwell)) reading.step_factor = kFreeStep;
    if (dwell.motion) {
      const std::array<int, 3> sweep{dwell.experiment, dwell.face, dwell.motion->sweep};
      const auto number = sweeps.try_emplace(sweep, static_cast<int>(sweeps.size()));
      if (number.second) data.sweeps.push_back(size_of(*dwell.motion, record.tolerances));
      reading.sweep = number.first->second;
      reading.rate_radps = Angle::degrees(dwell.motion->rate_deg_per_s).rad();
      reading.acceleration_radps2 = Angle::degrees(dwell.motion->acceleration_deg_per_s2).rad();
    }
    if (dwell.u_mean) reading.u = *dwell.u_mean;
    if (one_map_per_axis)
      reading.map = maps.try_emplace(pose_of(dwell), static_cast<int>(maps.size())).first->second;
    data.readings.push_back(reading);
    data.dwells.push_back(&dwell);
  }
  const std::vector<ReadingArrival> arrivals = arrivals_at(record, data.dwells);
  for (std::size_t i = 0; i < arrivals.size(); ++i) data.readings[i].arrival = arrivals[i].arrival;
  account_for_motion(data);
  if (data.readings.empty()) return data;
  data.u_known = all_known;
  const Eigen::Vector3d rough = rough_sensitivity(data.readings);
  for (EffectReading& reading : data.readings) {
    // The guess is above zero for an output that never changes, too.
    reading.u = data.u_known ? Eigen::Vector3d(reading.u.cwiseMax(kSmallestRelativeUncertainty * rough))
                             : Eigen::Vector3d((kGuessedRelativeUncertainty * rough).cwiseMax(1e-300));
  }
  return data;
}

}  // namespace abcal
