#pragma once

#include <array>
#include <nlohmann/json_fwd.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/results/analysis/report_data.h"
#include "protocol/estimators/checks/comparison.h"
#include "protocol/uncertainty/frozen_chart.h"

namespace abcal {

/// A run that cannot be a point of a chart, with every reason.
class CheckChartError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// Where a run was measured.
struct BenchIdentity {
  std::string stage;                     ///< Model and serial number as the stage reported them.
  std::string name;                      ///< [bench] name; may be empty.
  std::string stage_serial_number = {};  ///< That of `stage` alone; empty: not reported.
};

/// Subject of a chart: an item on a bench.
struct ChartSubject {
  std::string maker, model, serial_number;  ///< Identity of the item.
  BenchIdentity bench;
};
ChartSubject subject_of(const StoredRun& run);

struct ChartDifference {
  const char* what;  ///< "item", "stage", "bench"
  std::string found, required;
};
/// Differences that exclude a run from a chart; empty: it belongs to the chart.
std::vector<ChartDifference> differences(const ChartSubject& of_chart, const ChartSubject& of_run);

/// A run of a check standard, reduced to the data of a chart.
struct CheckRun : ChartSubject {
  std::string file, sha256, date;
  std::string estimator, response_unit;
  IntrinsicValues values;  ///< Sensitivities per g_loc.
  bool simulated = false;
  std::string doubtful;  ///< Why its result is doubtful; empty: it is not.
};

/// @throws CheckChartError for a CSV, a run that is not complete, was changed, or has no result
CheckRun check_run_of(const ReportData& data);

/// An approved baseline: the runs, and all that follows from them. It never changes.
struct CheckBaseline {
  std::vector<CheckRun> runs;
  IntrinsicValues centre, standard_deviation;
  ChartDemand demand;
  ChartRules rules;

  const CheckRun& first() const { return runs.front(); }
  std::array<std::string, 9> units() const;
};

inline constexpr std::size_t kFewestBaselineRuns = 5;
inline constexpr double kUsualRunLength = 200.0;

/// Centre, standard deviation and limits of a baseline.
/// @param run_length  check runs between two false alarms, at least, for nine baselines of ten
/// @throws CheckChartError too few runs, runs that do not belong together or occur twice, a doubtful result,
/// an
///         outlier (Grubbs, 1 % for all properties together), a property that does not scatter at all
CheckBaseline make_baseline(std::vector<CheckRun> runs, double run_length);

/// The baseline as stored in the register, and back. @throws CheckChartError for other text
std::string baseline_json(const CheckBaseline& baseline);
CheckBaseline baseline_from_json(const std::string& text);

/// A later run as a chart sees it.
struct ChartValue {
  IntrinsicValues values;
  bool begins_anew = false;  ///< Averages and sums restart with it.
};
using JudgedPoint = std::array<JudgedValue, 9>;

/// Judges points in the order of their runs.
std::vector<JudgedPoint> judge_points(const CheckBaseline& baseline, const std::vector<ChartValue>& points);

/// Properties that are outside, in words; empty: none.
std::string outside_words(const JudgedPoint& point);

/// Why a run cannot be the next point of a chart; empty: it can.
/// @param last_date  of the last point, or of the baseline
std::string against_point(const CheckBaseline& baseline, const CheckRun& run, const std::string& last_date);

std::string values_json(const IntrinsicValues& values);
/// @throws CheckChartError
IntrinsicValues values_from_json(const std::string& text);

}  // namespace abcal
