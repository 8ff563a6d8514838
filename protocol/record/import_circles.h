#pragma once

#include "protocol/record/run_record.h"
#include "protocol/record/table_cells.h"

namespace abcal {

/// Reads the averages of the three experiments (docs/run_file.md, "The CSV") into a record, up to its
/// comments, and what follows from all of them: closing angles, steps.
void import_circles(TableReader& table, const TableColumns& columns, TableProblems& problems,
                    RunRecord& record);

}  // namespace abcal
