#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

namespace abcal {

/// A raw time series of one accelerometer that is placed by hand: at rest, moved, at rest again.
struct TimeSeries {
  std::vector<double> time_s;
  std::vector<Eigen::Vector3d> reading;  ///< R
};

struct StaticSearch {
  double window_s = 1.0;      ///< Window of the sliding standard deviation.
  double threshold = 3.0;     ///< At rest: below this multiple of the noise floor.
  double min_length_s = 2.0;  ///< Poses with less still time are not used.
  double trim_s = 0.3;        ///< Time cut off both ends of each stretch.
};

/// One stretch without motion, trimmed: samples first .. last - 1, without those of a knock in between.
struct StaticStretch {
  std::size_t first = 0, last = 0;
  std::size_t count = 0;  ///< Samples used.
  double start_s = 0.0, end_s = 0.0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();    ///< R
  Eigen::Vector3d spread = Eigen::Vector3d::Zero();  ///< Standard deviation of single readings (R).
  Eigen::Vector3d u_mean = Eigen::Vector3d::Zero();  ///< From batch means (autocorrelation) (R).
};

/// Stretches where every output's standard deviation over a sliding window stays below `threshold` times that
/// output's noise floor (the lowest tenth of all windows). Neighbours with the same mean, as before and after
/// a knock, are one stretch. Empty: nothing is at rest.
/// @throws std::invalid_argument times not finite or not ascending, sizes differ, options not positive
std::vector<StaticStretch> static_stretches(const TimeSeries& series, const StaticSearch& search = {});

}  // namespace abcal
