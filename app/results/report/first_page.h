#pragma once

#include "app/ground/document/document.h"
#include "app/results/estimates/report_data.h"

namespace abcal {

/// The first page of a report: the verdict, the values with their expanded uncertainties, the equation that
/// they belong to, and how far the accelerometer is from an ideal one. Nothing here is for the operator.
Section first_page(const ReportData& data);

}  // namespace abcal
