#pragma once

#include <filesystem>
#include <string>

#include "app/results/report_data.h"

namespace abcal {

/// Writes the record that `data` was gathered from, and its results, as HDF5 (app/report/record_hdf5.h), by
/// the helper program abcal-hdf5: other commands need not load HDF5.
/// @param file_name final name of the file (NeXus: file_name), if `path` is temporary
/// @throws ProgramMissing, RunInterrupted, std::runtime_error with the words of the helper
/// @param all_items  of a run with several: not of the item of `data` alone
void export_hdf5(const ReportData& data, const std::filesystem::path& path, const std::string& file_name,
                 bool all_items = false);

}  // namespace abcal
