#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// A run file or a CSV of averaged readings, distinguished by their content.
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

/// Number of items of a run file; 1 for any other file.
std::size_t items_of_file(const std::filesystem::path& path);

/// The item of a run file, or of a CSV with its one item, that a command is about.
/// @param asked  from 1; 0: none was asked for, which only a file of one item allows
/// @throws std::invalid_argument an item that the file does not have, or none of several
int chosen_item(const std::filesystem::path& path, int asked);

/// The item that is shown where none is asked for (0): the first that was not dropped; if all were, the
/// first.
int shown_item(const StoredRun& run, int asked);

/// One item of a run file or of a CSV. FILE#K as the path is its item K.
/// @param item  from 1; 0: as the path says, or the only one
/// @throws RunFileError, CsvError, std::runtime_error, each with the problem of the file.
/// @throws std::invalid_argument  as chosen_item()
LoadedRecord load_record(const std::filesystem::path& path, int item = 0);

/// The items of a run file in their order. A CSV is a run of one item of which nothing but the record is
/// known.
/// @throws as load_record()
std::vector<StoredRun> load_items(const std::filesystem::path& path);

/// How commands name an item: "a.run#2"; the only one of a file by the file alone.
std::string name_of_item(const std::string& file, const StoredRun& run);

/// Words about an item of a run: "item 2: ..."; about the only one, the words alone.
std::string about_item(const StoredRun& run, const std::string& words, const char* separator = ": ");

}  // namespace abcal
