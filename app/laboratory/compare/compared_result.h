#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/results/analysis/analyses.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/response_unit.h"
#include "protocol/record/run_record.h"
#include "protocol/record/table_columns.h"

namespace abcal {

/// A result that can be compared with others: from a run, a table of readings, or a certificate.
struct ComparedResult {
  std::string file;  ///< Name as given.
  std::string kind;  ///< "run", "measurement", "CSV", "certificate", "table" with covariance
  std::string what;  ///< "abc estimator"; number of a certificate
  /// Estimator of a run or a CSV, or the one that a certificate of this program names; empty: another
  /// program's certificate.
  std::string estimator;
  bool published = false;  ///< Values of the published formula, not of the line response.
  std::string date;        ///< ISO 8601, of the measurement; empty: not known.
  std::string item;        ///< Maker, model and serial number in words; empty: not known.
  std::string item_serial_number;
  std::string stage;                          ///< Model and serial number; empty: not known.
  std::string stage_serial_number;            ///< Empty: not known; two stages of one model may be one.
  std::map<std::string, std::string> labels;  ///< Labels of a run: "operator.name", ...; to group by.

  std::string unit_name;  ///< Name of the unit of the response R.
  UnitMeaning unit;       ///< Meaning of that unit.
  /// Sensitivities are R/g_loc (true) or R/(m/s2).
  bool per_g_loc = true;
  std::optional<Quantity> g_loc;  ///< m/s2
  std::string g_loc_source;

  IntrinsicValues values;  ///< NaN: not given.
  Covariance9 covariance;  ///< NaN where not given.
  /// Standard uncertainties from the scatter of the readings alone; absent for a certificate.
  std::optional<IntrinsicValues> type_a;
  bool with_correlations = true;          ///< False: only the diagonal of the covariance is known.
  std::optional<Eigen::Matrix3d> matrix;  ///< Absent for the norm estimator.
  Covariance12 output_covariance;         ///< For matrix and offset; valid only if `matrix` is present.
  std::optional<RunRecord> record;        ///< Record that it was computed from; absent for a certificate.
  /// Its run, and the number of its item, from 1; null for a certificate. Two results of one run have the
  /// same run. Of a stored result it has what stored_result() gives.
  std::shared_ptr<const AnalysedRun> run;
  int item_of_run = 1;
  bool is_stored = false;  ///< Its numbers are those stored with the run; the readings were not fitted again.
  std::vector<std::string> notes;

  std::filesystem::path path;  ///< The file, without links.
  std::string sha256;          ///< SHA-256 of the bytes of the file.
  /// Last link of the chain of a run's dwells, of each run of a measurement: a copy of the run has it too,
  /// however its bytes lie. Empty: no run, or one of version 2.
  std::vector<std::string> chains;

  /// Whether its numbers are those of the common fit of its run's items.
  bool of_common_fit() const;
  /// Its part of the joint fit of its run. Only for a result of the joint estimator.
  const TrayItemResult& joint() const;
};

/// Whether two results were measured on one stage.
enum class SameStage {
  kYes,      ///< Both name the same serial number, or are of one run.
  kNo,       ///< They name different ones.
  kUnknown,  ///< One of them does not name its stage, or only a model that both have.
};
SameStage on_same_stage(const ComparedResult& first, const ComparedResult& second);

/// Results that cannot be compared: usage (exit code 2).
class CompareError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// Refuses a measurement that is named twice: it agrees with itself, and the uncertainty of the mean would be
/// too small. Results that are not analysed yet are compared by their files alone.
/// @throws CompareError
void require_different_measurements(const std::vector<ComparedResult>& results);

/// Where the results of runs come from.
enum class ResultSource {
  kStored,  ///< As stored with the run, where stored_result() has it; else the readings.
  kReadings,
};

/// Loads the named results: certificates, run files, CSVs of readings and tables of quantities with their
/// covariance (read_covariance_table()), distinguished by their content; FILE#K is item
/// K of a run with several (an existing file with this whole name takes precedence); one such run alone gives
/// all its items. A measurement that is named twice is refused before any is analysed; each run is analysed
/// at most once.
/// @param estimator  for runs and CSVs; empty: the one that each of them declares
/// @param item  the item of each run that is named without #K, from 1; 0: the only one
/// @param options  of the tables
/// @throws as load_items() and read_certificate(); std::runtime_error for a record that gives no usable
///         result, with the reason; CompareError for a run of several items without #K if it is not alone,
///         and for an item that it does not have; as require_different_measurements()
std::vector<ComparedResult> load_compared(const std::vector<std::string>& names, const std::string& estimator,
                                          ResultSource source, int item = 0,
                                          const TableOptions& options = {});

/// The estimator of a comparison where none is stated: empty, that each result declares; with a shared stage
/// the published protocol's, for whose equations alone the common effect of a stage on two results is known.
std::string estimator_to_compare(const std::string& stated, bool shared_stage);

/// Takes the numbers of the published formula (Geist & Gaitan 2021, Eqs. 5 to 10) for every run and CSV, with
/// the paper's own uncertainty: for comparison with ABC results of other laboratories. Certificates of other
/// programs are taken as they are.
/// @throws CompareError a result of another estimator than abc, and a certificate of this program, which has
///         the line response alone; all of them at once
void take_published_formula(std::vector<ComparedResult>& results);

/// Brings all into the response unit of the first, and sensitivities per m/s2 where they were measured at
/// different or by certificates; per g_loc where all were measured at the same one. The notes of a result
/// describe its conversion.
/// @return notes that concern all
/// @throws CompareError units that cannot be converted into one another
std::vector<std::string> convert_to_common_units(std::vector<ComparedResult>& results);

/// "V/g_loc", "degree", "V", ... in the order of Covariance9, after convert_to_common_units().
std::array<std::string, 9> units_of_properties(const ComparedResult& result);

}  // namespace abcal
