#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "app/results/report_data.h"

namespace abcal {

/// The record and its result as HDF5, in the program abcal-hdf5 (app/report/hdf5_export.h starts it) with
/// NeXus conventions (docs/report.md names every dataset): units on every number, standard uncertainties
/// beside their values as NAME_errors, single readings where the record is a run. Readable with h5py and
/// any other reader of HDF5.
/// @param file_name final name of the file (NeXus: file_name), if `path` is temporary
/// @throws RunFileError, std::runtime_error (the message of HDF5)
void write_hdf5(const ReportData& data, const std::filesystem::path& path, const std::string& file_name);

/// The same of all items of a run: an NXentry of each, item_1, item_2 and so on, and what they share, the
/// object abcal.tray/1, in the first.
void write_hdf5(std::span<const ReportData> items, const std::filesystem::path& path,
                const std::string& file_name);

}  // namespace abcal
