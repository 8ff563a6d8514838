#include <fmt/format.h>
#include <fmt/ranges.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/stage_record_file.h"
#include "app/commands/analyse.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/table_options.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/measurement_file.h"
#include "app/results/analysis/recompute.h"
#include "app/results/analysis/result_json.h"
#include "app/results/analysis/result_summary.h"
#include "app/results/analysis/series_of_runs.h"
#include "app/results/analysis/stage_record_use.h"
#include "app/results/analysis/tray_results.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/terminal.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

/// An item of a run and the result to be stored for it.
using Kept = std::pair<const StoredRun*, const CalibrationResult*>;

/// Stores analyses with a closed run or a measurement. A failure (a read-only folder) is only a warning.
void keep(const std::filesystem::path& path, const std::vector<Kept>& analyses) {
  const bool is_run = RunFile::looks_like_run_file(path) && RunFile::is_closed(path);
  if (!is_run && !looks_like_measurement(path)) return;
  try {
    ResultsFile results(path, sha256_of_file(path));
    if (results.made_again()) {
      print_log("{} was missing and is created again; earlier analyses are unknown\n",
                ResultsFile::path_beside(path).string());
    }
    const std::string utc = format_utc(RealClock().utc_now());
    for (const auto& [run, result] : analyses) keep_analysis(results, utc, *result, *run);
  } catch (const RunFileError& error) {
    print_log("warning: the analysis was not stored: {}\n", error.what());
  }
}

struct AnalyseOptions {
  std::vector<std::string> files;
  std::string file;  ///< All of them, for messages and commands.
  std::string stage_record;
  std::string estimator;
  std::string truth;
  TableOptions table;
  int item = 0;
  ResultForm form = ResultForm::kSummary;
  bool json() const { return form == ResultForm::kJson; }
};

/// The text of a result: of one item, or of a run.
template <class Analysed>
std::string text_of(const Analysed& analysed, const AnalyseOptions& options) {
  const std::string file = with_table_options(options.file, options.table);
  return options.form == ResultForm::kFull ? full_text(analysed, file, stdout)
                                           : summary_text(analysed, file, stdout);
}

/// Lets the items use the record that was given. It is not part of the run and could not be used again to
/// verify a stored result: the results are not kept.
void use_given_record(const AnalyseOptions& options, std::vector<StoredRun>& items) {
  use_stage_record(items, std::make_shared<const StageRecord>(read_stage_record(options.stage_record)),
                   options.file);
}

/// All items of a run with several, by the joint estimator.
int show_all(const AnalyseOptions& options, std::vector<StoredRun> items) {
  if (!options.truth.empty())
    throw std::invalid_argument(fmt::format("--truth: {} has {} items; required: --item 1 to {} as well",
                                            options.file, items.size(), items.size()));
  if (!options.estimator.empty() && options.estimator != "joint")
    throw std::invalid_argument(
        fmt::format("--estimator {}: {} has several items, which only the joint estimator analyses together; "
                    "required: --item as well",
                    options.estimator, options.file));
  if (!options.stage_record.empty()) use_given_record(options, items);
  const AnalysedRun run = analyse_run(std::move(items), "joint");
  std::vector<Kept> kept;
  for (const AnalysedItem& item : run.items) kept.emplace_back(&item.stored, &item.results.front());
  if (options.stage_record.empty()) keep(options.file, kept);
  options.json() ? print_result("{}\n", tray_json(run).dump(2)) : print_result("{}", text_of(run, options));
  return run.joint.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
}

/// One item by the requested estimator, else by the one that the run declares. `joint` fits all items
/// together; every other estimator uses this item alone.
int show_one(const AnalyseOptions& options, std::vector<StoredRun> items, int k) {
  std::string estimator = options.estimator;
  if (!options.stage_record.empty()) {
    if (!estimator.empty() && estimator != "joint")
      throw std::invalid_argument(fmt::format(
          "--stage-record: the {} estimator has no stage; required: --estimator joint", estimator));
    estimator = "joint";
    use_given_record(options, items);
  }
  if (estimator.empty() && options.form != ResultForm::kFull)
    estimator = declared_estimator(items.front().record).name;
  const AnalysedRun run = analyse_run(std::move(items), estimator);
  const AnalysedItem& item = run.item(k);
  const StoredRun& stored = item.stored;
  const CalibrationResult& result = item.results.front();
  if (options.stage_record.empty()) keep(options.file, {{&stored, &result}});
  options.json() ? print_result("{}\n", result_json(result).dump(2))
                 : print_result("{}", text_of(item, options));
  const bool agrees = options.truth.empty() ||
                      show_truth(options.truth, stored, result, options.json() ? stderr : stdout).agrees();
  return result.verdict == Verdict::kNotUsable || !agrees ? kExitFailed : kExitDone;
}

/// Several runs, or a measurement, by one joint fit.
int show_measurement(const AnalyseOptions& options) {
  if (!options.truth.empty())
    throw std::invalid_argument(
        fmt::format("--truth: {}: each run has a truth of its own; required: one run", options.file));
  if (options.files.size() == 1) {
    if (!options.stage_record.empty())
      throw std::invalid_argument(
          fmt::format("--stage-record: {} states which record it uses; required: a measurement with that "
                      "record (abcal combine ... --stage-record {})",
                      options.file, options.stage_record));
    return print_measurement(analyse_file(options.file, options.estimator), options.file, options.form,
                             options.item == 0 ? 0 : chosen_item(options.file, options.item));
  }
  if (!options.estimator.empty() && options.estimator != "joint")
    throw std::invalid_argument(
        fmt::format("--estimator {}: several runs are fitted by the joint estimator", options.estimator));
  std::optional<StageRecord> record;
  if (!options.stage_record.empty()) record = read_stage_record(options.stage_record);
  return print_measurement(analyse_series_of_runs(options.files, record), options.file, options.form,
                           options.item == 0 ? 0 : chosen_item(options.files.front(), options.item));
}

}  // namespace

int print_measurement(const AnalysedRun& run, const std::string& files, ResultForm form, int item) {
  std::vector<Kept> kept;
  for (const AnalysedItem& each : run.items) kept.emplace_back(&each.stored, &each.results.front());
  keep(files, kept);
  const AnalysedItem* const one = item > 0 ? &run.item(item) : nullptr;
  switch (form) {
    case ResultForm::kJson:
      print_result("{}\n", (one ? result_json(one->results.front()) : analysis_json(run)).dump(2));
      break;
    case ResultForm::kFull:
      print_result("{}", one ? full_text(*one, files, stdout) : full_text(run, files, stdout));
      break;
    case ResultForm::kSummary:
      print_result("{}", one ? summary_text(*one, files, stdout) : summary_text(run, files, stdout));
      break;
  }
  const Verdict verdict = one ? one->results.front().verdict : run.joint.verdict;
  return verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
}

TruthComparison show_truth(const std::string& bench_file, const StoredRun& run,
                           const CalibrationResult& result, std::FILE* stream) {
  const BenchConfig bench = read_bench(bench_file);
  TruthComparison comparison =
      compare_with_truth(result, run.record, bench, bench.has_several_items() ? run.item : 1);
  const std::string heading =
      fmt::format("Compared with the simulated truth ({} estimator)", result.estimator);
  const std::string text =
      fmt::format("\n{}\n{}", emphasised(stream, Emphasis::kHeading, heading), comparison.text);
  stream == stderr ? print_log("{}", text) : print_result("{}", text);
  return comparison;
}

CLI::App* add_analyse(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<AnalyseOptions>();
  CLI::App* command = parent.add_subcommand(
      "analyse", "Sensitivity matrix, offsets and intrinsic properties of a run or CSV");
  command->alias("analyze");
  command
      ->add_option(
          "FILE", options->files,
          "run file, measurement (abcal combine), or table of readings: averages at angles, poses, or "
          "a time series. Several: runs of one item on one stage, for one joint fit")
      ->required()
      ->expected(1, 1000);
  command
      ->add_option("--estimator", options->estimator,
                   fmt::format("{} (default: the estimator chosen before the run, {} if none was chosen; of "
                               "a table joint with "
                               "angles and norm without; --full shows all)",
                               estimator_choice(), kPublishedEstimator))
      ->check(CLI::IsMember(estimator_names()));
  command->add_option("--item", options->item,
                      "of a run with several items: this one alone, from 1 (default: all of them)");
  command->add_option(
      "--stage-record", options->stage_record,
      "record of the stage (`abcal stage learn`), from which the joint estimator takes the stage");
  add_table_options(*command, options->table);
  add_form_options(*command, options->form,
                   "print one JSON object, schema abcal.result/1; of several items abcal.tray/1");
  command->add_option(
      "--truth", options->truth,
      "compare with the simulated truth of this bench file; exit 1 beyond 4 standard uncertainties");
  command->callback([options, &exit_code] {
    options->file = fmt::format("{}", fmt::join(options->files, " "));
    if (options->files.size() > 1 || looks_like_measurement(options->file)) {
      exit_code = show_measurement(*options);
      return;
    }
    std::vector<StoredRun> items = load_items(options->file, options->table);
    say_how_read(options->file, items.front().record);
    const bool all = options->item == 0 && items.size() > 1;
    exit_code = all ? show_all(*options, std::move(items))
                    : show_one(*options, std::move(items), chosen_item(options->file, options->item));
  });
  return command;
}

}  // namespace abcal
