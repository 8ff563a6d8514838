#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "app/bench/bench_config.h"
#include "app/results/estimators.h"
#include "app/results/load_record.h"
#include "protocol/analysis/analyse_tray.h"
#include "protocol/analysis/calibration_result.h"

namespace abcal {

/// One estimator on one record. A record that the estimator refuses gives Verdict::kNotUsable with the
/// reason; any other exception is a bug of the program and is not caught.
CalibrationResult analyse(const RunRecord& record, const std::string& estimator);
CalibrationResult analyse(const RunRecord& record, const Estimator& estimator);

/// Several estimators on one record; what they share is computed once.
std::vector<CalibrationResult> analyse(const RunRecord& record,
                                       const std::vector<const Estimator*>& estimators);

/// Every estimator of the list, the declared one first: the others are the independent check of every run.
std::vector<CalibrationResult> analyse_all(const RunRecord& record);

/// The items of one run together (analyse_tray), each with the checks of its record.
TrayResult analyse_items(std::span<const RunRecord> records);

/// Every output compared with the truth of a simulated bench: the difference in standard uncertainties.
struct TruthComparison {
  std::string text;
  double largest = 0.0;  ///< Largest difference, in standard uncertainties.
  double allowed = 4.0;  ///< 4 standard uncertainties: 1 in 16 000 for each output by chance.
  bool agrees() const { return largest <= allowed; }
};
TruthComparison compare_with_truth(const CalibrationResult& result, const BenchConfig& bench);

}  // namespace abcal
