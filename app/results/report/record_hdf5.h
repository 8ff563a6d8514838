#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "app/results/estimates/report_data.h"

namespace abcal {

/// The record and its result as HDF5, in the program abcal-hdf5 (app/results/report/hdf5_export.h starts it)
/// with NeXus conventions (docs/report.md names every dataset): units on every number, standard uncertainties
/// as NAME_errors next to their values, single readings where the record is a run. Readable with h5py and any
/// other reader of HDF5.
/// @param file_name final name of the file (NeXus: file_name), if `path` is temporary
/// @throws RunFileError, std::runtime_error (the message of HDF5)
/// @param items  one, in the NXentry "entry"; or all items of a run with several: an NXentry of each, item_1,
/// item_2 and so on, and the object abcal.tray/1, which they share, in the first
void write_hdf5(std::span<const ReportData> items, const std::filesystem::path& path,
                const std::string& file_name);

}  // namespace abcal
