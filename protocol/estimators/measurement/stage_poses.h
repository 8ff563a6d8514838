#pragma once

#include <map>
#include <span>
#include <tuple>
#include <vector>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The poses of the stage in one run in the order of measurement, and the pose of each dwell of each item.
class StagePoses {
 public:
  /// @param records  of the items of one run; they must outlive this
  explicit StagePoses(std::span<const RunRecord> records);
  /// A dwell of any item at each pose.
  std::span<const DwellRecord* const> poses() const { return poses_; }
  /// Number of the pose of a dwell, from 0.
  int of(const DwellRecord* dwell) const { return place_.at(dwell); }
  std::vector<int> of(const CollectedReadings& data) const;

 private:
  using Key = std::tuple<int, int, DwellRole, bool>;
  void add(const RunRecord& record);

  std::vector<const DwellRecord*> poses_;
  std::map<Key, std::vector<int>> by_key_;
  std::map<const DwellRecord*, int> place_;
};

}  // namespace abcal
