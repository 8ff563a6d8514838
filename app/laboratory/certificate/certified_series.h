#pragma once

#include <vector>

#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// All contradictions to the claim that the runs are one complete series over temperature of the item of a
/// run, on its bench: another item, output, bench or bench file, a missing or repeated point, no return to
/// the reference, a run that belongs to no series.
std::vector<Reason> problems_of_series(const std::vector<ReportData>& points, const ReportData& run);

/// The points in the order of their series, and their polynomials.
/// @param problems  receives the reason if no polynomials result
CertifiedSeries certified_series(std::vector<ReportData> points, std::vector<Reason>& problems);

}  // namespace abcal
