#pragma once

#include <optional>
#include <string_view>

#include "protocol/record/run_file.h"
#include "protocol/record/sqlite.h"

namespace abcal {

/// Sets a fact of the table `meta`.
void set_meta(SqliteDatabase& database, std::string_view key, std::string_view value);
void set_timing(SqliteDatabase& database, const RunTiming& timing);

/// Writes all that a run file holds before the first angle. Within a transaction, after the tables were made.
void write_run_header(SqliteDatabase& database, const RunHeader& header);

/// Reads the header, with state and timing, from a file of any version, for the item `run.item`.
/// @param source of the file, for messages
/// @throws RunFileError for an item that the run does not have
void read_run_header(SqliteDatabase& database, const std::string& source, StoredRun& run);

/// How an instrument of one item of several is called: "item-3". The only one is the "accelerometer".
std::string item_role(int item);

/// @throws RunFileError for any other word
RunState run_state_from(const std::string& word);

}  // namespace abcal
