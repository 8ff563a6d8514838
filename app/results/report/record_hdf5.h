#pragma once

#include <iosfwd>
#include <span>
#include <string>

#include "app/results/analysis/report_data.h"

namespace abcal {

/// The record and its result as groups and datasets of an HDF5 file with NeXus conventions (docs/report.md
/// names every dataset): units on every number, standard uncertainties as NAME_errors next to their values,
/// single readings where the record is a run. Readable with h5py and any other reader of HDF5, once the
/// program abcal-hdf5 has written it (app/results/report/hdf5_export.h).
/// @param items  one, in the NXentry "entry"; or all items of a run with several: an NXentry of each, item_1,
/// item_2 and so on, and the object abcal.tray/1, which they share, in the first
/// @param file_name  of the HDF5 file (NeXus: file_name)
/// @param tree  receives the nodes (app/document/data_tree.h); a failure is in its state
/// @throws RunFileError
void write_hdf5_tree(std::span<const ReportData> items, const std::string& file_name, std::ostream& tree);

}  // namespace abcal
