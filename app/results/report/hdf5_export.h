#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "app/results/estimates/report_data.h"

namespace abcal {

/// Writes the records that `items` of one file were gathered from, and their results, as HDF5
/// (app/results/report/record_hdf5.h), by the helper program abcal-hdf5: other commands need not load HDF5.
/// @param file_name final name of the file (NeXus: file_name), if `path` is temporary
/// @throws ProgramMissing, RunInterrupted, std::runtime_error with the words of the helper
void export_hdf5(std::span<const ReportData> items, const std::filesystem::path& path,
                 const std::string& file_name);

}  // namespace abcal
