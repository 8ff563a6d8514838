#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/plan/run_config.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// An estimator of the program. A further one is one more entry of estimators().
struct Estimator {
  std::string name;   ///< As on the command line and in CalibrationResult::estimator.
  std::string words;  ///< Description for the report, after the name.
  /// Gives the sensitivity matrix with its covariance, which a certificate requires.
  bool certifiable = false;
  bool needs_angles = true;  ///< False: accepts poses whose angles are not known.
  /// Stage errors are unknowns of the fit, so that chi2 is near the degrees of freedom on a real stage.
  bool fits_stage_errors = false;
  /// Relies on the stated sizes of all effects, and can test few of them: if the joint fit of the same
  /// readings contradicts one, the result is doubtful.
  bool rests_on_stated_sizes = false;
  /// The result of a record. Null: the joint fit, which takes all items of a run together (analyse_items).
  /// @throws the exceptions of the analysis for a record that it refuses
  CalibrationResult (*fit)(const RunRecord& record) = nullptr;
};

/// All estimators, in the order of the reports.
const std::vector<Estimator>& estimators();

/// Their names, for the command line.
const std::vector<std::string>& estimator_names();

/// "abc, joint or norm".
std::string estimator_choice();

/// @throws std::invalid_argument for a name that is not in the list
const Estimator& find_estimator(std::string_view name);

/// The estimator whose result is the result of the record: the one chosen before its first angle, and the
/// published protocol where none was recorded.
/// @throws std::invalid_argument for one that this program does not know
const Estimator& declared_estimator(const RunRecord& record);

/// The result of one estimator among those of a record. @throws std::logic_error if it is absent
const CalibrationResult& result_of(const std::vector<CalibrationResult>& results, std::string_view estimator);

}  // namespace abcal
