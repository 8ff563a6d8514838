#include "protocol/estimators/shared/run_time.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

namespace abcal {

std::vector<double> run_time_fractions(const RunRecord& record) {
  double first = std::numeric_limits<double>::infinity();
  double last = -first;
  bool timed = true;
  for (const DwellRecord& dwell : record.dwells) {
    if (!dwell.time_s || !std::isfinite(*dwell.time_s)) {
      timed = false;
      break;
    }
    first = std::min(first, *dwell.time_s);
    last = std::max(last, *dwell.time_s);
  }
  timed = timed && last > first;
  std::vector<double> fractions;
  fractions.reserve(record.dwells.size());
  const double intervals = static_cast<double>(std::max<std::size_t>(record.dwells.size(), 2) - 1);
  for (std::size_t i = 0; i < record.dwells.size(); ++i) {
    if (timed) {
      fractions.push_back((*record.dwells[i].time_s - first) / (last - first) - 0.5);
    } else {
      fractions.push_back(record.dwells.size() == 1 ? 0.0 : static_cast<double>(i) / intervals - 0.5);
    }
  }
  return fractions;
}

std::vector<double> check_time_fractions(const RunRecord& record) {
  const std::vector<DwellRecord>& dwells = record.dwells;
  const auto has_time = [](const DwellRecord& dwell) { return dwell.time_s && std::isfinite(*dwell.time_s); };
  bool timed = dwells.size() > 1 && std::all_of(dwells.begin(), dwells.end(), has_time);
  for (const CheckDwell& check : record.check_poses) timed = timed && has_time(check.dwell);
  double first = 0.0, span = 0.0;
  if (timed) {
    const auto [least, most] = std::minmax_element(
        dwells.begin(), dwells.end(), [](const auto& a, const auto& b) { return *a.time_s < *b.time_s; });
    first = *least->time_s;
    span = *most->time_s - first;
  }
  std::vector<double> fractions;
  const double intervals = static_cast<double>(std::max<std::size_t>(dwells.size(), 2) - 1);
  for (const CheckDwell& check : record.check_poses) {
    fractions.push_back(span > 0.0 ? (*check.dwell.time_s - first) / span - 0.5
                                   : (static_cast<double>(check.after) - 0.5) / intervals - 0.5);
  }
  return fractions;
}

}  // namespace abcal
