#pragma once

#include <optional>

#include "app/document/document.h"
#include "app/results/analysis/report_data.h"

namespace abcal {

/// The first page of a report: the verdict, the values with their expanded uncertainties, the equation that
/// they belong to, and how far the accelerometer is from an ideal one. Nothing here is for the operator.
Section first_page(const ReportData& data);

/// The part of it that a result alone determines: verdict, values with their expanded uncertainties, and the
/// figure.
/// @param nominal  as of deviation_figure()
Section result_section(const CalibrationResult& result, std::optional<double> nominal);

}  // namespace abcal
