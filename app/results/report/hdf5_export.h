#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "app/results/analysis/report_data.h"

namespace abcal {

/// Writes records and their results as HDF5 (app/results/report/record_hdf5.h), by the helper program
/// abcal-hdf5: abcal need not load HDF5, and the helper knows nothing else.
/// @param items  of one file
/// @param file_name  final name of the file (NeXus: file_name), if `path` is temporary
/// @throws ProgramMissing, RunInterrupted, RunFileError, std::runtime_error (also the message of HDF5)
void export_hdf5(std::span<const ReportData> items, const std::filesystem::path& path,
                 const std::string& file_name);

}  // namespace abcal
