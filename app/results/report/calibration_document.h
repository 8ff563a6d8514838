#pragma once

#include "app/document/document.h"
#include "app/results/analysis/report_data.h"

namespace abcal {

/// The report of a record, with whatever data it contains: item, bench, conditions, method, results with
/// standard and expanded uncertainty, checks, budget, flags and events, raw data and program. Without a
/// usable verdict it has no numbers but says why. Additional content (of a certificate, its laboratory) is
/// inserted as sections.
Document calibration_document(const ReportData& data);

}  // namespace abcal
