#pragma once

#include <string>
#include <vector>

#include "app/results/analysis/analyses.h"

namespace abcal {

/// Analyses runs of one item on one stage together and writes them as a measurement.
/// @param stage_record  its file; empty: the record that all runs keep, if they do
/// @throws std::invalid_argument a run that is not closed, all of them at once; another file in that place;
/// as analyse_series_of_runs()
AnalysedRun combine(const std::vector<std::string>& runs, const std::string& stage_record,
                    const std::string& measurement);

}  // namespace abcal
