#pragma once

#include <span>
#include <vector>

#include "protocol/model/arrival.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The motions by which the stage reached some dwells of a record. The order of the motions and the approach
/// from below are those that the record states (RunRecord::axes_order, approach); if it states neither, only
/// a motion of one axis to a larger angle is known. The way to the first dwell, to one that was repeated, and
/// to one after a sweep is not known.
/// @param dwells  of the record, in the order of time
std::vector<ReadingArrival> arrivals_at(const RunRecord& record, std::span<const DwellRecord* const> dwells);

}  // namespace abcal
