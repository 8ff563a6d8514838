#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/results/tray_results.h"
#include "protocol/analysis/calibration_result.h"
#include "protocol/analysis/comparison.h"
#include "protocol/plan/response_unit.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// A result that can be compared with others: from a run, a CSV of averaged readings, or a certificate.
struct ComparedResult {
  std::string file;  ///< As given.
  std::string kind;  ///< "run", "CSV", "certificate"
  std::string what;  ///< "abc estimator"; number of a certificate
  std::string date;  ///< ISO 8601, of the measurement; empty: not known.
  std::string item;  ///< Maker, model and serial number in words; empty: not known.
  std::string item_serial_number;
  std::string stage;                          ///< Model and serial number; empty: not known.
  std::map<std::string, std::string> labels;  ///< Of a run: "operator.name", ...; to group by.

  std::string unit_name;  ///< Of the response R.
  UnitMeaning unit;       ///< The same.
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
  Covariance12 output_covariance;         ///< Of matrix and offset; read only where there is a matrix.
  std::optional<RunRecord> record;        ///< What it was computed from; absent for a certificate.
  /// The run with several items that it is of, and which of them (from 0); null: none. Two results of one run
  /// have the same.
  std::shared_ptr<const TrayRun> tray;
  std::size_t tray_item = 0;
  std::vector<std::string> notes;

  std::string sha256;  ///< Of the bytes of the file.
  /// Last link of the chain of a run's dwells: a copy of the run has it too, however its bytes lie. Empty: no
  /// run, or one of version 2.
  std::string chain;

  /// Whether its numbers are those of the common fit of its run's items.
  bool of_common_fit() const;
};

/// Results that cannot be compared: usage (exit code 2).
class CompareError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// Reads and, where it is a record, analyses one file. Its content decides which of the three it is.
/// @param estimator  of records; empty: the one that each record declares
/// @throws as load_record() and read_certificate(); std::runtime_error for a record that gives no
///         usable result, with the reason
ComparedResult load_compared(const std::filesystem::path& path, const std::string& estimator);

/// The results that a person names: files as load_compared() reads them; FILE#K, item K of a run with several
/// (a file of that very name comes first); one such run alone, all its items. Of several items the estimator
/// is the joint one unless another is named, and each run is analysed once.
/// @throws as load_compared(); CompareError for a run of several items beside others without #K, and for an
///         item that it does not have
std::vector<ComparedResult> load_all_compared(const std::vector<std::string>& names,
                                              const std::string& estimator);

/// Brings all into the response unit of the first, and sensitivities per m/s2 where they were measured at
/// different or by certificates; per g_loc where all were measured at the same one. Says in the notes of a
/// result what was done to it.
/// @return notes that concern all
/// @throws CompareError units that cannot be made into one another
std::vector<std::string> convert_to_common_units(std::vector<ComparedResult>& results);

/// "V/g_loc", "degree", "V", ... in the order of Covariance9, after convert_to_common_units().
std::array<std::string, 9> units_of_properties(const ComparedResult& result);

}  // namespace abcal
