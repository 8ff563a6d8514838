#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "protocol/record/run_record.h"
#include "protocol/record/table_columns.h"

namespace abcal {

/// Adds --columns, --unit, --time-unit, --topic and --keep-mapping.
void add_table_options(CLI::App& command, TableOptions& options);

/// A file with the options that it needs, as a command takes both: "a.csv --unit g".
std::string with_table_options(const std::string& file, const TableOptions& options);

/// Says on standard error how a table was understood; nothing of a run.
void say_how_read(const std::string& file, const RunRecord& record);

}  // namespace abcal
