#include "protocol/estimators/measurement/stage_poses.h"

#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <utility>

namespace abcal {
namespace {

/// Largest time (s) between two items' dwells at one angle. Items read at different rates may have the
/// middle of a dwell at different times, but closer to each other than to that of any other dwell.
double same_time(const RunRecord& record) {
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 1; i < record.dwells.size(); ++i) {
    const auto& [before, now] = std::pair(record.dwells[i - 1].time_s, record.dwells[i].time_s);
    if (before && now && *now > *before) least = std::min(least, *now - *before);
  }
  return 0.5 * least;
}

}  // namespace

StagePoses::StagePoses(std::span<const RunRecord> records) {
  for (const RunRecord& record : records) add(record);
}

std::vector<int> StagePoses::of(const CollectedReadings& data) const {
  std::vector<int> out;
  for (const DwellRecord* dwell : data.dwells) out.push_back(of(dwell));
  return out;
}

void StagePoses::add(const RunRecord& record) {
  const double within = same_time(record);
  std::map<Key, std::size_t> visits;  // of this record
  for (const DwellRecord& dwell : record.dwells) {
    const Key key(dwell.experiment, dwell.n, dwell.role, dwell.closing);
    std::vector<int>& known = by_key_[key];
    const std::size_t visit = visits[key]++;
    int found = -1;
    for (std::size_t i = 0; i < known.size() && found < 0; ++i) {
      const std::optional<double>& time = poses_[static_cast<std::size_t>(known[i])]->time_s;
      const bool same = time && dwell.time_s ? std::abs(*time - *dwell.time_s) <= within : i == visit;
      if (same) found = known[i];
    }
    if (found < 0) {
      found = static_cast<int>(poses_.size());
      known.push_back(found);
      poses_.push_back(&dwell);
    }
    place_[&dwell] = found;
  }
}

}  // namespace abcal
