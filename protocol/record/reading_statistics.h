#pragma once

#include <Eigen/Core>
#include <limits>
#include <span>

namespace abcal {

/// Statistics of the finite readings at one angle. Not a number where there are none.
struct ReadingStatistics {
  Eigen::Vector3d mean = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());  ///< R
  /// R, standard deviation of one reading.
  Eigen::Vector3d spread = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// R. spread / sqrt(effective number of readings), and never below the output's resolution / sqrt(12):
  /// averaging does not recover digits that a converter rounds away.
  Eigen::Vector3d u_mean = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
};

/// @param outputs     u, v, w of each reading, R
/// @param resolution  smallest step of an output, R; 0: not known
ReadingStatistics reading_statistics(std::span<const Eigen::Vector3d> outputs, double resolution);

/// Mean and spread alone.
ReadingStatistics mean_and_spread(std::span<const Eigen::Vector3d> outputs);

/// How many independent readings carry as much as these (autocorrelation time summed over the lags up to the
/// first that does not exceed the noise, 2/sqrt(n)). Between 1 and n. Takes a time of n log n.
double effective_number_of_readings(std::span<const double> values);

}  // namespace abcal
