#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "app/results/report_data.h"

namespace abcal {

/// The averaged readings as CSV: comments "# key: value" with everything that the analysis and a reader need
/// besides the numbers, then the columns of import_csv(). Numbers have as many digits as tell them apart, so
/// that the analysis of the copy gives the same results. Angles without a finite mean are left out, and a
/// comment says so.
std::string averaged_csv(const ReportData& data);

/// The same of all items of a run, with the number of the item in the first column, `item`; the keys of an
/// item's comments begin with "item-K.".
std::string averaged_csv(std::span<const ReportData> items);

/// The single readings of a run as CSV, dwell by dwell, also of angles that were measured again for
/// comparison
/// (`repeat`: their first dwell counts).
/// @throws std::invalid_argument for a record without a run file, which has no single readings
/// @throws RunFileError, std::runtime_error
void write_raw_csv(const ReportData& data, const std::filesystem::path& path);
/// The same of all items of a run, with the number of the item in the first column, `item`.
void write_raw_csv(std::span<const ReportData> items, const std::filesystem::path& path);

}  // namespace abcal
