#include "protocol/estimators/joint/collect_readings.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include "protocol/estimators/shared/run_time.h"
#include "protocol/estimators/shared/unusable_data.h"

namespace abcal {
namespace {

/// No reading is believed better than this times S_j: a noise-free record stays solvable (in double precision
/// the normal matrix holds the priors down to about 1e-9), and no real accelerometer comes near.
constexpr double kSmallestRelativeUncertainty = 1e-9;
/// First guess of a noise that nobody stated, times S_j: the fit replaces it.
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

/// In units of `step_deg`: so large that the angle of such a dwell tells nothing of the stage.
constexpr double kFreeStep = 100.0;

/// Whether the step error of a dwell is drawn without regard to others. The axis repeats some unknown part of
/// it where it comes again: at a closing angle that of the first angle, and at 0 degrees, where a map has its
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

/// Commanded angle of the axis that turns.
Angle turned_angle(const DwellRecord& dwell) {
  return dwell.experiment == 3 ? dwell.commanded_z : dwell.commanded_x;
}

void count_from_middle_of_sweeps(CollectedReadings& data, const std::vector<double>& turned_deg) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  std::vector<std::pair<double, double>> ends(data.sweeps.size(), {kInfinity, -kInfinity});
  for (std::size_t i = 0; i < data.readings.size(); ++i) {
    if (data.readings[i].sweep < 0) continue;
    auto& [low, high] = ends[static_cast<std::size_t>(data.readings[i].sweep)];
    low = std::min(low, turned_deg[i]);
    high = std::max(high, turned_deg[i]);
  }
  for (std::size_t i = 0; i < data.readings.size(); ++i) {
    if (data.readings[i].sweep < 0) continue;
    const auto& [low, high] = ends[static_cast<std::size_t>(data.readings[i].sweep)];
    data.readings[i].turned_rad = Angle::degrees(turned_deg[i] - 0.5 * (low + high)).rad();
  }
}

/// Sums over one sweep that give the phase of its readings.
struct SweepPhase {
  std::array<std::complex<double>, 3> of_output{};
  double rate_radps = 0.0;
  int experiment = 0;
  int count = 0;
};

/// The delay shows as a phase of the readings that grows with the rate: the difference of two sweeps of a
/// circle is free of all that depends on the angle alone.
std::array<double, 2> delays_of(const CollectedReadings& data) {
  std::vector<SweepPhase> sweeps(data.sweeps.size());
  for (const EffectReading& reading : data.readings) {
    if (reading.sweep < 0) continue;
    SweepPhase& sweep = sweeps[static_cast<std::size_t>(reading.sweep)];
    for (std::size_t j = 0; j < 3; ++j)
      sweep.of_output[j] += reading.value(static_cast<Eigen::Index>(j)) *
                            std::complex<double>(reading.cos_alpha, -reading.sin_alpha);
    sweep.rate_radps += reading.rate_radps;
    sweep.experiment = reading.experiment;
    ++sweep.count;
  }
  std::array<double, 2> sum{}, weight{};
  for (std::size_t a = 0; a < sweeps.size(); ++a) {
    for (std::size_t b = a + 1; b < sweeps.size(); ++b) {
      if (sweeps[a].experiment != sweeps[b].experiment || sweeps[a].count == 0 || sweeps[b].count == 0)
        continue;
      const double apart = sweeps[a].rate_radps / sweeps[a].count - sweeps[b].rate_radps / sweeps[b].count;
      std::complex<double> both = 0.0;
      for (std::size_t j = 0; j < 3; ++j) both += sweeps[a].of_output[j] * std::conj(sweeps[b].of_output[j]);
      const std::size_t axis = sweeps[a].experiment == 3 ? 1 : 0;
      sum[axis] -= std::arg(both) * apart;
      weight[axis] += apart * apart;
    }
  }
  // Rates that differ by less do not show it.
  constexpr double kLeastApart = 0.05;  // radian/s
  for (std::size_t axis = 0; axis < 2; ++axis)
    sum[axis] = weight[axis] > kLeastApart * kLeastApart ? sum[axis] / weight[axis] : 0.0;
  return sum;
}

/// The course of one sweep: angles with their times and rates, in the order of time.
struct Passage {
  double time_s = 0.0;
  double angle_rad = 0.0;
  double rate_radps = 0.0;
  double acceleration_radps2 = 0.0;
};

/// How far the axis turned within the `delay_s` before a passage: by Hermite's cubic between the passages of
/// its sweep, beyond the first one by the rate and acceleration there.
double turned_within(const std::vector<Passage>& sweep, const Passage& at, double delay_s) {
  const double then = at.time_s - delay_s;
  const auto after = std::ranges::upper_bound(sweep, then, {}, &Passage::time_s);
  if (after == sweep.begin() || after == sweep.end())
    return delay_s * (at.rate_radps - 0.5 * delay_s * at.acceleration_radps2);
  const Passage& b = *after;
  const Passage& a = *(after - 1);
  const double span = b.time_s - a.time_s;
  const double x = (then - a.time_s) / span;
  const double angle = a.angle_rad * (1.0 + 2.0 * x) * (1.0 - x) * (1.0 - x) +
                       a.rate_radps * span * x * (1.0 - x) * (1.0 - x) +
                       b.angle_rad * x * x * (3.0 - 2.0 * x) - b.rate_radps * span * x * x * (1.0 - x);
  return at.angle_rad - angle;
}

/// Turns the readings' angles to those that the item saw.
void account_for_delays(CollectedReadings& data) {
  data.delay_s = delays_of(data);
  std::vector<std::vector<Passage>> sweeps(data.sweeps.size());
  const auto passage_of = [&](std::size_t n) {
    const EffectReading& reading = data.readings[n];
    return Passage{data.dwells[n]->time_s.value_or(0.0), turned_angle(*data.dwells[n]).rad(),
                   reading.rate_radps, reading.acceleration_radps2};
  };
  for (std::size_t n = 0; n < data.readings.size(); ++n)
    if (data.readings[n].sweep >= 0)
      sweeps[static_cast<std::size_t>(data.readings[n].sweep)].push_back(passage_of(n));
  for (std::vector<Passage>& sweep : sweeps) std::ranges::sort(sweep, {}, &Passage::time_s);
  for (std::size_t n = 0; n < data.readings.size(); ++n) {
    EffectReading& reading = data.readings[n];
    if (reading.sweep < 0) continue;
    const double behind = turned_within(sweeps[static_cast<std::size_t>(reading.sweep)], passage_of(n),
                                        data.delay_s[reading.experiment == 3 ? 1 : 0]);
    const double s = std::sin(behind), c = std::cos(behind);
    const double sin_alpha = reading.sin_alpha * c - reading.cos_alpha * s;
    reading.cos_alpha = reading.cos_alpha * c + reading.sin_alpha * s;
    reading.sin_alpha = sin_alpha;
  }
}

}  // namespace

CollectedReadings collect_readings(const RunRecord& record, bool one_map_per_axis) {
  CollectedReadings data;
  const std::vector<double> times = run_time_fractions(record);
  const bool two_faces = has_two_faces(record);
  bool all_known = true;
  std::map<std::pair<int, long long>, int> maps;
  std::map<std::array<int, 3>, int> sweeps;
  std::vector<double> turned_deg;  // For each reading.
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
      turned_deg.push_back(turned_angle(dwell).deg());
      reading.rate_radps = Angle::degrees(dwell.motion->rate_deg_per_s).rad();
      reading.acceleration_radps2 = Angle::degrees(dwell.motion->acceleration_deg_per_s2).rad();
    }
    if (dwell.u_mean) reading.u = *dwell.u_mean;
    if (one_map_per_axis)
      reading.map = maps.try_emplace(pose_of(dwell), static_cast<int>(maps.size())).first->second;
    if (!dwell.motion) turned_deg.push_back(0.0);
    data.readings.push_back(reading);
    data.dwells.push_back(&dwell);
  }
  count_from_middle_of_sweeps(data, turned_deg);
  account_for_delays(data);
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
