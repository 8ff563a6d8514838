#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/results/analysis/estimators.h"
#include "protocol/estimators/joint/analyse_tray.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// Results of estimators for the items of one run. A single item is a list of length 1.
struct RunAnalysis {
  /// The joint fit of all items together; empty if no requested estimator needs it.
  TrayResult joint;
  /// For each item one result per estimator, in the order of the request. The joint one is that of the common
  /// fit; every other one uses the readings of this item alone.
  std::vector<std::vector<CalibrationResult>> results;
};

/// A table without angles is no fault of its readings: the estimator is the wrong one.
/// @throws std::invalid_argument  an estimator that needs angles, for such a table
void require_angles(const RunRecord& record, const Estimator& estimator);

/// Several estimators on the items of one run. A record that an estimator refuses gives Verdict::kNotUsable
/// with the reason; any other exception is a bug of the program and is not caught.
/// @throws as require_angles()
RunAnalysis analyse_items(std::span<const RunRecord> records,
                          const std::vector<const Estimator*>& estimators);

/// As analyse_items(), for one item.
std::vector<CalibrationResult> analyse(const RunRecord& record,
                                       const std::vector<const Estimator*>& estimators);
CalibrationResult analyse(const RunRecord& record, const Estimator& estimator);
CalibrationResult analyse(const RunRecord& record, const std::string& estimator);

/// Every estimator of the list, the declared one first: the others are the independent check of every run.
std::vector<const Estimator*> all_estimators(const RunRecord& record);
std::vector<CalibrationResult> analyse_all(const RunRecord& record);

/// One item of a run as it was loaded, and its results.
struct AnalysedItem {
  StoredRun stored;
  std::vector<CalibrationResult> results;  ///< As in RunAnalysis; of a measurement the joint one.

  /// The result of the estimator that was chosen before the first angle; the only one where there is one.
  const CalibrationResult& result() const;
};

/// A run of a measurement of several.
struct RunOfMeasurement {
  std::string file;
  std::string sha256;
  std::vector<StoredRun> items;  ///< In the order of the first run.
  const StoredRun& stored() const { return items.front(); }
};

/// All items of a run, the one of a CSV, or that of a measurement of several runs, analysed together.
struct AnalysedRun {
  std::vector<AnalysedItem> items;
  TrayResult joint;  ///< As in RunAnalysis.
  /// Runs of a measurement in the order of their beginning, whose item is stored as in the first; empty: one
  /// run, or a CSV.
  std::vector<RunOfMeasurement> runs;

  /// The run file, or the first of a measurement.
  /// @param file  from which this was loaded
  std::filesystem::path first_run(const std::filesystem::path& file) const {
    return runs.empty() ? file : std::filesystem::path(runs.front().file);
  }
  const AnalysedItem& item(int k) const { return items.at(static_cast<std::size_t>(k) - 1); }
  AnalysedItem& item(int k) { return items.at(static_cast<std::size_t>(k) - 1); }
};

/// @param estimator  the only one to be applied; empty: all of them, the declared one first
/// @throws as require_angles()
AnalysedRun analyse_run(std::vector<StoredRun> items, const std::string& estimator = {});

/// Every output compared with the truth of a simulated bench, averaged over the times of the run's angles:
/// the difference in standard uncertainties.
struct TruthComparison {
  std::string text;
  double largest = 0.0;  ///< Largest difference, in standard uncertainties.
  double allowed = 4.0;  ///< 4 standard uncertainties: 1 in 16 000 for each output by chance.
  bool agrees() const { return largest <= allowed; }
};
TruthComparison compare_with_truth(const CalibrationResult& result, const RunRecord& record,
                                   const BenchConfig& bench, int item = 1);

}  // namespace abcal
