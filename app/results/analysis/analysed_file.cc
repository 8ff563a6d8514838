#include "app/results/analysis/analysed_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/bench_file/stage_record_file.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/series_of_runs.h"

namespace abcal {
namespace {

AnalysedRun analyse_measurement(const std::filesystem::path& path, const std::string& estimator) {
  const MeasurementFile measurement = read_measurement(path);
  std::vector<std::string> runs;
  for (const MeasurementPart& run : measurement.runs) runs.push_back(run.path.string());
  if (!estimator.empty() && estimator != "joint")
    throw std::invalid_argument(
        fmt::format("{}: a measurement of several runs has the joint result alone, and each of its runs a "
                    "result of the {} estimator; required: --estimator joint, or one of the runs: {}",
                    path.string(), estimator, fmt::join(runs, ", ")));
  std::optional<StageRecord> record;
  if (measurement.stage_record) record = read_stage_record(measurement.stage_record->path);
  return analyse_series_of_runs(runs, record);
}

}  // namespace

AnalysedRun analyse_file(const std::filesystem::path& path, const std::string& estimator,
                         const TableOptions& options) {
  return looks_like_measurement(path) ? analyse_measurement(path, estimator)
                                      : analyse_run(load_items(path, options), estimator);
}

AnalysedRun analyse_file_by(const std::filesystem::path& path, const std::string& asked,
                            const TableOptions& options) {
  if (!asked.empty() || looks_like_measurement(path)) return analyse_file(path, asked, options);
  std::vector<StoredRun> items = load_items(path, options);
  const std::string declared = declared_estimator(items.front().record).name;
  return analyse_run(std::move(items), declared);
}

}  // namespace abcal
