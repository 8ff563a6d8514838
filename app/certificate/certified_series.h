#pragma once

#include <vector>

#include "app/certificate/certificate.h"

namespace abcal {

/// What contradicts that the runs are one whole series over temperature of the item of a run, on its bench:
/// another item, output, bench or bench file, a point that is missing or there twice, no return to the
/// reference, a run that is none of a series. All of it.
std::vector<Problem> problems_of_series(const std::vector<ReportData>& points, const ReportData& run);

/// The points in the order of their series, and their polynomials.
/// @param problems  why there are none is added to them
CertifiedSeries certified_series(std::vector<ReportData> points, std::vector<Problem>& problems);

}  // namespace abcal
