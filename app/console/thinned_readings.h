#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "protocol/record/run_file.h"

namespace abcal::console {

/// Readings of dwells for a chart that is some columns of pixels wide. Each dwell is cut into equal parts, of
/// each of which the lowest and the highest reading of each output are kept; where there are more dwells than
/// columns, several dwells are one part. If there are few readings, each is a part of its own. The memory
/// does not grow with the readings.
class ThinnedReadings {
 public:
  /// Readings of one part. Readings that are not numbers are left out; a part without readings has NaN.
  struct Point {
    double time_s = 0.0;              ///< Middle of its first and last reading.
    Eigen::Vector3d lowest, highest;  ///< R
  };

  /// @param dwells   number of dwells that follow, at least 1 is assumed
  /// @param columns  at least 1 is assumed
  ThinnedReadings(std::size_t dwells, std::size_t columns);

  /// Adds the readings of the next dwell.
  void add(std::span<const StoredReading> readings);

  /// Readings added so far.
  std::size_t count() const { return count_; }
  /// At most twice as many as columns.
  const std::vector<Point>& points() const { return points_; }

 private:
  void add_part(std::span<const StoredReading> readings, bool with_last);

  std::size_t parts_;   ///< Parts of each dwell,
  std::size_t joined_;  ///< or dwells of each part.
  std::size_t dwells_ = 0, count_ = 0;
  double first_s_ = 0.0;  ///< Time of the first reading of the last point.
  std::vector<Point> points_;
};

}  // namespace abcal::console
