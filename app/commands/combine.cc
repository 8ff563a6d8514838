#include "app/commands/combine.h"

#include <fmt/format.h>

#include <memory>
#include <optional>
#include <stdexcept>

#include "app/bench_file/stage_record_file.h"
#include "app/commands/analyse.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/series_of_runs.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/version.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

struct CombineOptions {
  std::vector<std::string> runs;
  std::string output, stage_record;
  ResultForm form = ResultForm::kSummary;
};

/// A measurement names its runs by SHA-256, which only a closed run keeps.
void require_closed(const std::vector<RunOfMeasurement>& runs) {
  std::string problems;
  for (const RunOfMeasurement& run : runs)
    if (!RunFile::is_closed(run.file))
      problems += fmt::format("\n  {}: is {}; required: a complete run (abcal resume {})", run.file,
                              to_string(run.stored().state), run.file);
  if (!problems.empty()) throw std::invalid_argument("these runs are not closed:" + problems);
}

}  // namespace

AnalysedRun combine(const std::vector<std::string>& runs, const std::string& stage_record,
                    const std::string& measurement) {
  MeasurementFile file;
  file.created_utc = format_utc(RealClock().utc_now());
  file.program_version = program_version();
  std::optional<StageRecord> record;
  if (!stage_record.empty()) {
    record = read_stage_record(stage_record);
    file.stage_record = {stage_record, sha256_of_file(stage_record)};
  }
  AnalysedRun analysed = analyse_series_of_runs(runs, record);
  if (analysed.runs.size() < 2)
    throw std::invalid_argument(
        fmt::format("{} is one run; required: two or more. A run is a measurement of its own: every command "
                    "takes it as it is",
                    analysed.runs.front().file));
  require_closed(analysed.runs);
  file.items = static_cast<int>(analysed.items.size());
  for (const RunOfMeasurement& run : analysed.runs) file.runs.push_back({run.file, run.sha256});
  if (write_measurement(measurement, file)) {
    ResultsFile::begin(measurement);
    print_log("measurement written: {} ({} runs)\n", measurement, file.runs.size());
  }
  return analysed;
}

CLI::App* add_combine(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<CombineOptions>();
  CLI::App* command = parent.add_subcommand(
      "combine", "Make one measurement of several runs of one item: report, export, compare and verify it");
  command->add_option("RUN", options->runs, "run files of one item on one stage, in any mountings")
      ->required()
      ->expected(1, 1000);
  command->add_option("-o,--output", options->output, "file to write: NAME.measurement")->required();
  command->add_option("--stage-record", options->stage_record,
                      "record of the stage for the fit (default: the one that all runs keep)");
  add_form_options(*command, options->form, "print the result as one JSON object, schema abcal.result/1");
  command->callback([options, &exit_code] {
    const AnalysedRun analysed = combine(options->runs, options->stage_record, options->output);
    exit_code = print_measurement(analysed, options->output, options->form);
    print_log("next: abcal report {0} --pdf FILE.pdf, or export, compare, apply, uncertainty, verify {0}\n",
              options->output);
  });
  return command;
}

}  // namespace abcal
