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
/// @param item  of a run with several, from 1
LoadedRecord load_record(const std::filesystem::path& path, int item = 1);

}  // namespace abcal
