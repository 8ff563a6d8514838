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
/// have moved it by a step of its resolution, but for one dwell in 1e6. `resolution` 0: not known, any spread
/// moves it. Of an output whose usual spread is NaN (frozen since the start) it is that of the quietest of
/// the others.
bool is_stuck(const DwellStatistics& statistics, const std::optional<Eigen::Vector3d>& usual_spread,
              double resolution);

/// Whether the readings of a dwell spread so much more than usual that something shook the stage: beyond
/// `limits.spread_factor`, and beyond what noise does once in 1e6 dwells.
bool is_shaken(const DwellStatistics& statistics, const std::optional<Eigen::Vector3d>& usual_spread,
               double resolution, const LimitsConfig& limits);

/// What is wrong with a temperature, in words; nothing if it is within its limits or not known.
std::optional<std::string> temperature_excess(std::optional<double> temperature_degc,
                                              std::optional<double> first_degc, const LimitsConfig& limits,
                                              const Tolerances& tolerances);

/// Whether the norm of the readings at one angle, offset included, cannot be local gravity.
/// @param nominal  R for one g_loc
bool norm_is_wrong(const Eigen::Vector3d& mean, double nominal, const LimitsConfig& limits);

/// The response to one g_loc that the angles of one experiment show, free of offset and mounting: the root
/// mean square of half the differences between angles 180 degrees apart. Nothing unless such pairs go round
/// the circle evenly, at least three of them.
std::optional<double> response_of_circle(std::span<const DwellRecord> experiment);

/// What is wrong with the full scale, in words; nothing if it is as nominal.
std::optional<std::string> full_scale_excess(std::span<const DwellRecord> experiment, double nominal,
                                             const ExpectedItem& item);

/// Whether outputs and temperature stand still enough to begin: over the last `stability_s` of these windows
/// the means stay within the limit, and so do the temperatures.
struct StabilityWindow {
  double end_s = 0.0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();    ///< R
  Eigen::Vector3d u_mean = Eigen::Vector3d::Zero();  ///< R
  std::optional<double> temperature_degc;
};
bool is_stable(std::span<const StabilityWindow> windows, double stability_s, const LimitsConfig& limits,
               const Tolerances& tolerances);

}  // namespace abcal
