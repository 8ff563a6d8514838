#pragma once

#include "protocol/record/run_record.h"
#include "protocol/record/table_reader.h"

namespace abcal {

/// Reads the comments "# key: value" of a table, with the keys of a run file's table `meta`: `response_unit`
/// (names R), `g_loc.*`, `stage_uncertainty.*`, `item_uncertainty.*`, `tolerances.*`, `alignment.*`,
/// `pose_uncertainty_deg`, `limits.*`, `protocol.estimator`, `protocol.step_deg` and `protocol.steps`,
/// `continuations`, `row_order: time` (without times: the rows are in the order of measurement). Absent
/// entries leave what the record has; g_loc is then not known.
void read_comments(TableReader& table, TableProblems& problems, RunRecord& record);

}  // namespace abcal
