#pragma once

#include <filesystem>
#include <optional>

#include "protocol/record/run_file.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// A run file or a CSV of averaged readings, distinguished by their content.
struct LoadedRecord {
  RunRecord record;
  std::optional<StoredRun> run;  ///< Absent for a CSV.
};

/// @throws RunFileError, CsvError, std::runtime_error: each says what is wrong with the file.
/// @throws std::invalid_argument  several items, and none is named
/// @param item  of a run with several, from 1; 0: the run must have one only
LoadedRecord load_record(const std::filesystem::path& path, int item = 0);

}  // namespace abcal
