#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/import_table.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_record.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// A run file or a table of readings, distinguished by their content.
struct LoadedRecord {
  RunRecord record;
  std::optional<StoredRun> run;  ///< Absent for a CSV.
};

/// A file and the number of the requested item, from 1; 0: none is named.
struct NamedItem {
  std::filesystem::path file;
  int item = 0;
};

/// "a.run#2" is item 2 of a.run. An existing file with this whole name takes precedence.
/// @throws std::invalid_argument  no such file, and no number after the #
NamedItem named_item(const std::string& name);

/// Number of items of a run file, or of each run of a measurement; 1 for any other file.
std::size_t items_of_file(const std::filesystem::path& path);

/// The item of a run file, or of a CSV with its one item, that a command is about.
/// @param asked  from 1; 0: none was asked for, which only a file of one item allows
/// @throws std::invalid_argument an item that the file does not have, or none of several
int chosen_item(const std::filesystem::path& path, int asked);

/// The item that is shown where none is asked for (0): the first that was not dropped; if all were, the
/// first.
int shown_item(const StoredRun& run, int asked);

/// One item of a run file or of a table. FILE#K as the path is its item K.
/// @param item  from 1; 0: as the path says, or the only one
/// @param options  of a table
/// @throws RunFileError, TableError, std::runtime_error, each with the problem of the file; RunFileError also
/// for a run that was changed (read_as_stored()).
/// @throws std::invalid_argument  as chosen_item(); options of a table for a run file
LoadedRecord load_record(const std::filesystem::path& path, int item = 0, const TableOptions& options = {});

/// The items of a run file in their order, with the checks that were made while it was read; nullopt for a
/// table.
/// @throws as load_record()
std::optional<CheckedRun> load_run(const std::filesystem::path& path, const TableOptions& options = {});

/// The items of a run file in their order. A table is a run of one item of which nothing but the record is
/// known.
/// @throws as load_record()
std::vector<StoredRun> load_items(const std::filesystem::path& path, const TableOptions& options = {});

/// How commands name an item: "a.run#2"; the only one of a file by the file alone.
std::string name_of_item(const std::string& file, const StoredRun& run);

/// Words about an item of a run: "item 2: ..."; about the only one, the words alone.
std::string about_item(const StoredRun& run, const std::string& words, const char* separator = ": ");

}  // namespace abcal
