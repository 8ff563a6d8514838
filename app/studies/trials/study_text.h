#pragma once

#include <string>
#include <vector>

#include "protocol/uncertainty/run_uncertainty.h"
#include "protocol/uncertainty/simulation_sets.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// A simulation set in tables laid out like the paper's, with the printed numbers next to ours.
std::string study_text(const StudyResult& study);

/// The uncertainty of a run: outputs, budget, validation, effects that are not covered.
std::string study_text(const RunUncertainty& study);

/// One row for each case and output:
/// `case,output,unit,error,mean,standard_deviation,symmetric_low,symmetric_high,
/// shortest_low,shortest_high,paper,paper_standard_deviation`; absent values are empty.
std::string study_csv(const StudyResult& study);

}  // namespace abcal
