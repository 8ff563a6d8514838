#pragma once

#include <vector>

#include "protocol/record/run_record.h"

namespace abcal {

/// Time of each dwell of the record, from -1/2 (first) to 1/2 (last) over the whole run, closing angles
/// included: the t of the drift b_j t. From time_s where every dwell has it and it spans a time; else equal
/// spacing in row order. A single dwell is at 0.
std::vector<double> run_time_fractions(const RunRecord& record);

/// The same of the check poses, on the scale of the dwells: those before the first dwell or after the last
/// are just outside -1/2 to 1/2.
std::vector<double> check_time_fractions(const RunRecord& record);

}  // namespace abcal
