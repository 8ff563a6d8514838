#include "protocol/analysis/joint_data.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <string>
#include <utility>

#include "protocol/analysis/run_time.h"
#include "protocol/analysis/unusable_data.h"

namespace abcal {
namespace {

/// No reading is believed better than this times S_j: a noise-free record stays solvable (in double precision
/// the normal matrix holds the priors down to about 1e-9), and no real accelerometer comes near.
constexpr double kSmallestRelativeUncertainty = 1e-9;

/// S_j as the readings show it: half the range, good enough for a floor and a first guess of the noise.
Eigen::Vector3d rough_sensitivity(const std::vector<JointReading>& readings) {
  Eigen::Vector3d low = readings.front().value;
  Eigen::Vector3d high = low;
  for (const JointReading& reading : readings) {
    low = low.cwiseMin(reading.value);
    high = high.cwiseMax(reading.value);
  }
  return 0.5 * (high - low);
}

}  // namespace

JointData collect_joint_data(const RunRecord& record, bool one_map_per_axis) {
  JointData data;
  const std::vector<double> times = run_time_fractions(record);
  bool all_known = true;
  std::vector<const DwellRecord*> dwells;
  std::vector<JointReading> readings;
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
    JointReading reading;
    reading.experiment = dwell.experiment;
    reading.sin_alpha = alpha.sin;
    reading.cos_alpha = alpha.cos;
    reading.t = times[i];
    reading.value = dwell.mean;
    if (dwell.u_mean) reading.u = *dwell.u_mean;
    readings.push_back(reading);
    dwells.push_back(&dwell);
  }
  data.u_known = all_known && !readings.empty();

  // One step error a dwell (a closing angle too: the stage came back on its own), or one for each pose of an
  // axis.
  std::vector<std::size_t> order(readings.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  if (one_map_per_axis) {
    const auto key = [&](std::size_t i) {
      const int axis = readings[i].experiment == 3 ? 1 : 0;
      // Modulo 360 degrees, to the microdegree, so that equal angles compare equal.
      const double turn = dwells[i]->alpha.deg() - 360.0 * std::floor(dwells[i]->alpha.deg() / 360.0);
      return std::pair(axis, std::llround(turn * 1e6) % 360'000'000LL);
    };
    std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return key(a) < key(b); });
    int step = -1;
    for (std::size_t i = 0; i < order.size(); ++i) {
      if (i == 0 || key(order[i]) != key(order[i - 1])) ++step;
      readings[order[i]].step_error = step;
    }
  } else {
    for (std::size_t i = 0; i < readings.size(); ++i) readings[i].step_error = static_cast<int>(i);
  }
  for (const std::size_t i : order) {
    data.readings.push_back(readings[i]);
    data.dwells.push_back(dwells[i]);
  }
  if (data.u_known) {
    const Eigen::Vector3d floor = kSmallestRelativeUncertainty * rough_sensitivity(data.readings);
    for (JointReading& reading : data.readings) reading.u = reading.u.cwiseMax(floor);
  }
  return data;
}

JointFit fit_with_unknown_noise(std::vector<JointReading>& readings, const JointPriors& priors,
                                const JointModel& model) {
  const Eigen::Vector3d unit = rough_sensitivity(readings);
  if (!(unit.minCoeff() > 0.0))
    throw UnusableData(
        "an output has the same value at every angle: there is nothing to estimate the noise from");
  Eigen::Vector3d u = 1e-5 * unit;
  JointFit fit;
  // Each pass moves u by the factor that the residuals ask for; 1 % of an uncertainty is finer than 216
  // angles know it.
  for (int pass = 0; pass < 30; ++pass) {
    for (JointReading& reading : readings) reading.u = u;
    fit = joint_fit(readings, priors, model, true);
    if (!fit.converged) return fit;
    Eigen::Vector3d next;
    for (int j = 0; j < 3; ++j) {
      if (!(fit.redundancy(j) >= 1.0)) {
        throw UnusableData(fmt::format(
            "{} angles leave nothing to estimate the noise from; more angles or the uncertainties "
            "of the readings are required",
            readings.size()));
      }
      next(j) = std::max(u(j) * std::sqrt(fit.sum_weighted_squares(j) / fit.redundancy(j)),
                         kSmallestRelativeUncertainty * unit(j));
    }
    const double change = (next - u).cwiseQuotient(u).cwiseAbs().maxCoeff();
    u = next;
    if (change < 0.01) break;
  }
  return fit;
}

}  // namespace abcal
