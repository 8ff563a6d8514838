#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "app/results/analysis/report_data.h"

namespace abcal {

/// The averaged readings as CSV: comments "# key: value" with everything that the analysis and a reader need
/// in addition to the numbers, then the columns of import_table(). Numbers have enough digits to restore them
/// exactly, so that the analysis of the copy gives the same results. Angles without a finite mean are left
/// out, and a comment says so. Several items of one run have the number of the item in the first column,
/// `item`; the keys of an item's comments begin with "item-K.".
std::string averaged_csv(std::span<const ReportData> items);

/// The single readings of a run as CSV, dwell by dwell, also of angles that were measured again for
/// comparison
/// (`repeat`: their first dwell counts). Several items, which are all of one run, have the number of the item
/// in the first column, `item`.
/// @throws std::invalid_argument for a record without a run file, which has no single readings
/// @throws RunFileError, std::runtime_error
void write_raw_csv(std::span<const ReportData> items, const std::filesystem::path& path);

}  // namespace abcal
