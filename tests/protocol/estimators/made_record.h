#pragma once

#include <array>
#include <cstddef>
#include <random>

#include "protocol/estimators/shared/run_time.h"
#include "protocol/model/forward_model.h"
#include "protocol/record/imported_dwells.h"
#include "protocol/record/run_record.h"

namespace abcal::test {

/// A record of three experiments as the forward model makes it: N angles of `step`, no noise, no closing
/// angles.
inline RunRecord made_record(const AccelerometerModel& accelerometer, const AcsErrors& errors, int steps = 72,
                             Angle step = Angle::degrees(5.0)) {
  RunRecord record;
  record.source = "forward model";
  record.steps = steps;
  record.step = step;
  // The forward model has no further effects, and the record says so.
  record.tolerances = without_further_effects({});
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 1; n <= steps; ++n) {
      DwellRecord dwell;
      dwell.experiment = experiment;
      dwell.n = n;
      dwell.alpha = step * (n - 1);
      set_commanded_angles(dwell);
      record.dwells.push_back(dwell);
    }
  }
  const std::vector<double> t = run_time_fractions(record);
  for (std::size_t i = 0; i < record.dwells.size(); ++i) {
    DwellRecord& dwell = record.dwells[i];
    dwell.mean =
        response(accelerometer, gravity_in_aut(dwell.experiment, dwell.n, dwell.alpha, errors), t[i]);
  }
  return record;
}

/// Adds white noise and says so in u_mean.
inline void add_noise(RunRecord& record, double sigma, std::mt19937_64& engine) {
  std::normal_distribution<double> normal(0.0, sigma);
  for (DwellRecord& dwell : record.dwells) {
    for (Eigen::Index j = 0; j < 3; ++j) dwell.mean(j) += normal(engine);
    dwell.u_mean = Eigen::Vector3d::Constant(sigma);
  }
}

}  // namespace abcal::test
