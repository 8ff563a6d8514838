#pragma once

#include <filesystem>

#include "app/report/report_data.h"

namespace abcal {

/// The record and its result as HDF5 with NeXus conventions (docs/report.md names every dataset): units on
/// every number, standard uncertainties beside their values as NAME_errors, single readings where the record
/// is a run. Readable with h5py and whatever else reads HDF5.
/// @throws RunFileError, std::runtime_error (what HDF5 says)
void write_hdf5(const ReportData& data, const std::filesystem::path& path);

}  // namespace abcal
