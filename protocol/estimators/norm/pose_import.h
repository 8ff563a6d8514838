#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <istream>
#include <string>
#include <vector>

#include "protocol/record/run_record.h"

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
/// output's noise floor (the lowest tenth of all windows). Neighbours with the same mean are merged.
/// @throws std::invalid_argument times not finite or not ascending, sizes differ, options not positive
/// @throws std::runtime_error no static stretch
std::vector<StaticStretch> static_stretches(const TimeSeries& series, const StaticSearch& search = {});

/// Poses imported from a file of poses or from a time series.
struct ImportedPoses {
  RunRecord record;  ///< One dwell for each pose; experiment 0: angles unknown.
  bool from_time_series = false;
  std::size_t samples = 0;  ///< Samples of the time series.
  std::vector<StaticStretch> stretches;
};

/// Reads poses or a time series for the norm estimator. Comma, semicolon, tab or blanks separate columns;
/// lines that begin with # are comments; "# item_uncertainty.KEY: VALUE" states the size of an effect of the
/// item (protocol/plan/effect_sizes.h); effects not stated are left out. A header names the columns: r_u,
/// r_v, r_w (poses; u_u, u_v, u_w optional, other columns ignored), or t (also time, time_s) with three
/// further columns (time series). Without a header three columns are poses and four are a time series t, u,
/// v, w.
/// @throws std::invalid_argument with file and line: wrong number of columns, not a number, unknown header
/// @throws std::runtime_error the file cannot be read, or is empty
ImportedPoses import_poses(const std::filesystem::path& path, const StaticSearch& search = {});
ImportedPoses import_poses(std::istream& in, const std::string& source, const StaticSearch& search = {});

}  // namespace abcal
