#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/run_config.h"
#include "protocol/record/run_record.h"
#include "protocol/run/dwell.h"

namespace abcal {

/// Whether an output that did not change at all during a dwell must be stuck: noise of the usual spread would
/// have changed it by a step of its resolution, except in one of 1e6 dwells. `resolution` 0: not known, any
/// spread changes it. An output whose usual spread is NaN (frozen since the start) is judged by the spread of
/// the quietest of the others.
bool is_stuck(const DwellStatistics& statistics, const std::optional<Eigen::Vector3d>& usual_spread,
              double resolution);

/// Whether the readings of a dwell spread so much more than usual that something shook the stage: beyond
/// `limits.spread_factor`, and beyond what noise does once in 1e6 dwells.
bool is_shaken(const DwellStatistics& statistics, const std::optional<Eigen::Vector3d>& usual_spread,
               double resolution, const LimitsConfig& limits);

/// Description of a temperature outside its limits; absent if it is within them or not known.
std::optional<Message> temperature_excess(std::optional<double> temperature_degc,
                                          std::optional<double> first_degc, const LimitsConfig& limits,
                                          const Tolerances& tolerances);

/// Whether the norm of the readings at one angle, offset included, cannot be local gravity.
/// @param nominal  R for one g_loc
bool norm_is_wrong(const Eigen::Vector3d& mean, double nominal, const LimitsConfig& limits);

/// The response to one g_loc that a circle shows. A cubic non-linearity makes the two differ; both may be
/// what a maker calls the sensitivity.
struct CircleResponse {
  double at_zero = 0.0;   ///< From the slope at zero.
  double at_one_g = 0.0;  ///< From the readings at the two extremes.
};

/// The response from the angles of one experiment, free of offset and mounting: from half the differences
/// between angles 180 degrees apart, in which an even non-linearity cancels; their third harmonic shows the
/// cubic one. Absent unless at least four such pairs are spread evenly over the circle.
std::optional<CircleResponse> response_of_circle(std::span<const DwellRecord> experiment);

/// Description of a wrong full scale; absent if it is as nominal.
std::optional<Message> full_scale_excess(std::span<const DwellRecord> experiment, double nominal,
                                         const ExpectedItem& item);

/// Means over one window of readings before the first angle. is_stable() tests whether the run may begin:
/// means and temperatures stay within their limits over the last `stability_s` of the windows.
struct StabilityWindow {
  double end_s = 0.0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();    ///< R
  Eigen::Vector3d u_mean = Eigen::Vector3d::Zero();  ///< R
  std::optional<double> temperature_degc;
};
bool is_stable(std::span<const StabilityWindow> windows, double stability_s, const LimitsConfig& limits,
               const Tolerances& tolerances);

}  // namespace abcal
