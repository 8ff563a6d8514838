#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/item_identity.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/estimators.h"
#include "drivers/instrument/clock.h"
#include "protocol/estimators/joint/held_out_norm.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_record.h"
#include "protocol/record/table_columns.h"
#include "protocol/record/verify_run.h"
#include "protocol/uncertainty/budget.h"

namespace abcal {

/// Expanded uncertainties of figures are U = k u with this k, which for a normal distribution covers
/// kCoverageProbability.
inline constexpr double kCoverageFactor = 2.0;

/// Everything known about one record, gathered once for the report, the certificate and the console.
struct ReportData {
  std::filesystem::path path;                  ///< The run file, CSV or measurement.
  RunRecord record;                            ///< The analysed record.
  std::optional<StoredRun> run;                ///< The first of a measurement; absent for a CSV.
  std::optional<BenchConfig> bench;            ///< As it was at the run. Absent for a CSV, and if unreadable.
  std::string bench_unreadable;                ///< Why the bench file of a run cannot be read; empty: it can.
  int item = 1;                                ///< Number of the item in the run.
  std::shared_ptr<const AnalysedRun> all;      ///< All items of the run, this one among them.
  std::vector<CalibrationResult> results;      ///< One for each estimator; a refusal is a result too.
  std::string estimator{kPublishedEstimator};  ///< Estimator of the reported result.
  /// |a| on poses that the fit did not see; absent: the reported result is not a joint one, or has no folds.
  std::optional<HeldOutNorm> held_out_norm;
  std::optional<Budget> budget;  ///< Budget of the reported result; absent: it has no numbers.
  /// SHA-256 of the raw data: of the run file, or of the CSV. Absent while a run is not complete, since its
  /// file still changes.
  std::optional<std::string> sha256;
  std::vector<IntegrityCheck> integrity;  ///< Findings of `abcal verify`; empty for a CSV.
  std::vector<std::string> simulated;     ///< Instruments that were not real: "stage", "accelerometer".
  std::string program_version;            ///< Version of the program that makes the report.
  std::string created_utc;                ///< Time at which the report was made.

  /// The reported result; the others are its independent check.
  const CalibrationResult& result() const { return result_of(results, estimator); }
  /// Whether the result is that of several runs, which are in `all`.
  bool is_of_several_runs() const { return !all->runs.empty(); }
  /// Whether other items were measured together with this one.
  bool is_one_of_several() const { return all->items.size() > 1; }
  bool complete() const { return !run || run->state == RunState::kComplete; }
  /// A label of the run ("item.serial_number", "operator.name"); empty where it was not stated.
  std::string label(const std::string& key) const;
  /// UTC of the creation of the run, and of its last event; empty for a CSV.
  std::string started_utc() const;
  std::string ended_utc() const;
  /// From standstill to the first reading used: the least and the most of all angles of a run, in seconds.
  std::pair<double, double> settle_times_s() const;
};

/// Maker, model and serial number of the item as they were stated and read. A CSV has none.
ItemIdentityParts identity_of(const ReportData& data);

/// Whether a voltmeter read the item's outputs: its calibration is part of the traceability.
bool measured_by_voltmeter(const ReportData& data);

/// Properties of the voltmeter without a stated uncertainty: "gain of the voltmeter". Empty if no voltmeter
/// measured.
std::vector<Term> unstated_voltmeter(const ReportData& data);

/// The warnings at the top of every report of the data: not complete, not usable, doubtful, simulated, not
/// consistent, a bench file that this program cannot read, replayed. Empty: none.
std::vector<std::string> cautions(const ReportData& data);

/// Reads and analyses an item of a run file, of a table or of a measurement. `now` is the time of the report.
/// @param path  FILE#K is item K of FILE
/// @param item  from 1; 0: as the path says, or the only one. Its joint result is that of the common fit of
/// all items
/// @throws RunFileError, TableError, std::runtime_error, each with the problem of the file;
///         std::invalid_argument: as chosen_item()
ReportData gather_report(const std::filesystem::path& path, Clock::UtcTime now, int item = 0);

/// As gather_report(), for every item in order (0), or for one; the run is checked and analysed once.
/// @param options  of a table
std::vector<ReportData> gather_items(const std::filesystem::path& path, Clock::UtcTime now, int item = 0,
                                     const TableOptions& options = {});

}  // namespace abcal
