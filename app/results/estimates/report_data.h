#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/ground/bench_file/bench_config.h"
#include "app/results/estimates/analyses.h"
#include "app/results/estimates/estimators.h"
#include "drivers/instrument/clock.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_record.h"
#include "protocol/record/verify.h"
#include "protocol/uncertainty/budget.h"

namespace abcal {

/// Expanded uncertainties are U = k u with this k ...
inline constexpr double kCoverageFactor = 2.0;
/// ... which for a normal distribution covers approximately this probability (JCGM 100:2008, 6.2.2, G.1.3).
inline constexpr double kCoverageProbability = 0.95;

/// Everything known about one record, gathered once for the report, the certificate and the console.
struct ReportData {
  std::filesystem::path path;                  ///< The run file or CSV.
  RunRecord record;                            ///< What was analysed.
  std::optional<StoredRun> run;                ///< Absent for a CSV.
  std::optional<BenchConfig> bench;            ///< As it was at the run. Absent for a CSV, and if unreadable.
  std::string bench_unreadable;                ///< Why the bench file of a run cannot be read; empty: it can.
  int item = 1;                                ///< Whose record it is, of the items of the run.
  std::shared_ptr<const AnalysedRun> all;      ///< All items of the run, this one among them.
  std::vector<CalibrationResult> results;      ///< One an estimator; a refusal is a result too.
  std::string estimator{kPublishedEstimator};  ///< Whose result is reported; the others are its check.
  std::optional<Budget> budget;                ///< Of the reported result; absent where that has no matrix.
  /// SHA-256 of the raw data: of the closed run file, or of the CSV. Absent while a run is not closed, since
  /// its file still changes.
  std::optional<std::string> sha256;
  std::vector<IntegrityCheck> integrity;  ///< Of a run: as `abcal verify` finds it.
  std::vector<std::string> simulated;     ///< Instruments that were not real: "stage", "accelerometer".
  std::string program_version;            ///< Of the program that makes the report.
  std::string created_utc;                ///< When the report was made.

  /// What is reported; the others are its independent check.
  const CalibrationResult& result() const { return result_of(results, estimator); }
  /// Whether other items were measured together with this one.
  bool is_one_of_several() const { return all->items.size() > 1; }
  bool complete() const { return !run || run->state == RunState::kComplete; }
  /// A label of the run ("item.serial_number", "operator.name"); empty where it was not stated.
  std::string label(const std::string& key) const;
  /// UTC of the first angle's run start, and of the last event; empty for a CSV.
  std::string started_utc() const;
  std::string ended_utc() const;
  /// From standstill to the first reading used: the least and the most of all angles of a run, in seconds.
  std::pair<double, double> settle_times_s() const;
};

/// Whether a voltmeter read the item's outputs: its calibration is part of the traceability.
bool measured_by_voltmeter(const ReportData& data);

/// What of the voltmeter that measured has no stated uncertainty: "gain of the voltmeter". Empty where none
/// measured.
std::vector<std::string> unstated_voltmeter(const ReportData& data);

/// The warnings at the top of every report of the data: not complete, not usable, doubtful, simulated, not
/// consistent, a bench file that this program cannot read. Empty: there are none.
std::vector<std::string> cautions(const ReportData& data);

/// Reads and analyses an item of a run file or of a CSV. `now` is the time of the report.
/// @param path  FILE#K is item K of FILE
/// @param item  from 1; 0: as the path says, or the only one. Its joint result is that of the common fit of
/// all items
/// @throws RunFileError, CsvError, std::runtime_error: each says what is wrong with the file;
///         std::invalid_argument: as chosen_item()
ReportData gather_report(const std::filesystem::path& path, Clock::UtcTime now, int item = 0);

/// The same of every item, in their order (0), or of one; the run is checked and analysed once.
std::vector<ReportData> gather_items(const std::filesystem::path& path, Clock::UtcTime now, int item = 0);

}  // namespace abcal
