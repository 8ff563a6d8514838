#pragma once

#include <filesystem>
#include <string>

#include "app/results/analysis/analyses.h"
#include "protocol/record/table_columns.h"

namespace abcal {

/// Loads and analyses a run, a table of readings, or a measurement of several runs.
/// @param estimator  the only one to be applied; empty: all of them, the declared one first. A measurement
/// has the joint result alone
/// @param options  of a table
/// @throws as load_items(), read_measurement() and analyse_series_of_runs(); std::invalid_argument for
/// another estimator than the joint one of a measurement
AnalysedRun analyse_file(const std::filesystem::path& path, const std::string& estimator = {},
                         const TableOptions& options = {});

/// As analyse_file(), by one estimator: the one that is asked for, else the one that the file declares.
AnalysedRun analyse_file_by(const std::filesystem::path& path, const std::string& asked,
                            const TableOptions& options = {});

}  // namespace abcal
