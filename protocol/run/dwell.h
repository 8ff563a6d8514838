#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>

#include "drivers/instrument/accelerometer.h"
#include "protocol/record/reading_statistics.h"

namespace abcal {

/// The statistics of the readings at one angle.
struct DwellStatistics {
  std::int64_t count = 0;       ///< Finite readings, the ones averaged.
  std::int64_t not_finite = 0;  ///< Left out.
  std::int64_t lost = 0;        ///< Gaps in the sequence numbers.
  Eigen::Vector3d mean = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());  ///< R
  Eigen::Vector3d spread =
      Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());  ///< R, of one reading
  /// R. spread / sqrt(effective number of readings), and never below the output's resolution / sqrt(12):
  /// averaging does not reveal what a converter rounds away.
  Eigen::Vector3d u_mean = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  std::optional<double> temperature_degc;
  std::uint32_t flags = 0;  ///< DwellFlag: clipped, not finite, lost readings.
};

/// The statistics of the readings taken at one angle.
DwellStatistics dwell_statistics(std::span<const Reading> readings, const AccelerometerInfo& info);

/// Standard deviation of single readings, at least one.
Eigen::Vector3d spread_of(std::span<const Reading> readings);

/// Whether a window of readings shows neither a slope (Student's t of a least-squares line, at a false alarm
/// in 1e5 windows) nor more spread than `spread_factor` times `usual_spread` (not checked where that is
/// absent or NaN). Changes below `resolution` (R) never count.
/// @param drift  standard deviation of the drift from one reading to the next, relative to the mean's norm,
///               which is not motion
bool is_quiet(std::span<const Reading> window, const std::optional<Eigen::Vector3d>& usual_spread,
              double spread_factor, double resolution, double drift = 0.0);

}  // namespace abcal
