#include <fmt/format.h>
#include <fmt/ranges.h>

#include <filesystem>
#include <fstream>
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
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/other_file.h"
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
#include "protocol/estimators/norm/pose_import.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

/// A file of poses or a time series serves the norm estimator alone; a run or a CSV with angles serves all.
bool has_no_angles(const std::filesystem::path& path) {
  if (RunFile::looks_like_run_file(path)) return false;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line.front() == '#' || line == "\r") continue;
    return line.find("experiment") == std::string::npos;
  }
  return false;
}

/// An item of a run and the result to be stored for it.
using Kept = std::pair<const StoredRun*, const CalibrationResult*>;

/// Stores analyses with a closed run. A failure (a read-only folder) is only a warning.
void keep(const std::filesystem::path& path, const std::vector<Kept>& analyses) {
  if (!RunFile::looks_like_run_file(path) || !RunFile::is_closed(path)) return;
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
  int item = 0;
  ResultForm form = ResultForm::kSummary;
  bool json() const { return form == ResultForm::kJson; }
};

/// The items of a run or CSV. An estimator that needs no angles also accepts a file without angles.
std::vector<StoredRun> load(const AnalyseOptions& options) {
  std::error_code error;
  if (options.estimator.empty() || find_estimator(options.estimator).needs_angles ||
      !std::filesystem::is_regular_file(options.file, error) || !has_no_angles(options.file))
    return load_items(options.file);
  refuse_other_file(options.file, kRunOrCsv);
  std::vector<StoredRun> poses(1);
  poses.front().record = import_poses(options.file).record;
  return poses;
}

/// The text of a result: of one item, or of a run.
template <class Analysed>
std::string text_of(const Analysed& analysed, const AnalyseOptions& options) {
  return options.form == ResultForm::kFull ? full_text(analysed, stdout)
                                           : summary_text(analysed, options.file, stdout);
}

/// All items of a run with several, by the joint estimator.
int show_all(const AnalyseOptions& options, std::vector<StoredRun> items) {
  if (!options.truth.empty())
    throw std::invalid_argument(fmt::format("--truth: {} has {} items; required: --item 1 to {} as well",
                                            options.file, items.size(), items.size()));
  if (!options.estimator.empty() && options.estimator != "joint")
    throw std::invalid_argument(fmt::format(
        "--estimator {}: {} has several items, which only the joint estimator analyses together; required: "
        "--item as well",
        options.estimator, options.file));
  if (!options.stage_record.empty())
    throw std::invalid_argument(
        fmt::format("--stage-record: {} has several items, which are fitted together without a record; "
                    "required: --item as well",
                    options.file));
  const AnalysedRun run = analyse_run(std::move(items), "joint");
  std::vector<Kept> kept;
  for (const AnalysedItem& item : run.items) kept.emplace_back(&item.stored, &item.results.front());
  keep(options.file, kept);
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
    use_stage_record(items, std::make_shared<const StageRecord>(read_stage_record(options.stage_record)),
                     options.file);
    if (items.size() > 1) items = {std::move(items[static_cast<std::size_t>(k) - 1])};
    k = 1;
  }
  if (estimator.empty() && options.form != ResultForm::kFull)
    estimator = declared_estimator(items.front().record).name;
  const AnalysedRun run = analyse_run(std::move(items), estimator);
  const AnalysedItem& item = run.item(k);
  const StoredRun& stored = item.stored;
  const CalibrationResult& result = item.results.front();
  // A record that is not part of the run could not be used again to verify a stored result.
  if (options.stage_record.empty()) keep(options.file, {{&stored, &result}});
  options.json() ? print_result("{}\n", result_json(result).dump(2))
                 : print_result("{}", text_of(item, options));
  const bool agrees = options.truth.empty() ||
                      show_truth(options.truth, stored, result, options.json() ? stderr : stdout).agrees();
  return result.verdict == Verdict::kNotUsable || !agrees ? kExitFailed : kExitDone;
}

/// Checks the options of an analysis of several runs, and prints it.
int show_series(const AnalyseOptions& options) {
  if (options.item != 0 || !options.truth.empty())
    throw std::invalid_argument(
        "several files are the runs of one item in a series; required: neither --item nor "
        "--truth");
  if (!options.estimator.empty() && options.estimator != "joint")
    throw std::invalid_argument(
        fmt::format("--estimator {}: runs of a series are fitted by the joint estimator", options.estimator));
  std::optional<StageRecord> record;
  if (!options.stage_record.empty()) record = read_stage_record(options.stage_record);
  return print_series(options.files, record, options.form);
}

}  // namespace

int print_series(const std::vector<std::string>& files, const std::optional<StageRecord>& record,
                 ResultForm form) {
  const AnalysedItem series = analyse_series_of_runs(files, record);
  switch (form) {
    case ResultForm::kJson:
      print_result("{}\n", result_json(series.results.front()).dump(2));
      break;
    case ResultForm::kFull:
      print_result("{}", full_text(series, stdout));
      break;
    case ResultForm::kSummary:
      print_result("{}", summary_text(series, fmt::format("{}", fmt::join(files, " ")), stdout));
      break;
  }
  return series.results.front().verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
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
          "run file, or CSV of averaged readings (norm: of poses, or a time series). Several: runs of one "
          "item on one stage, in several mountings, for one joint fit")
      ->required()
      ->expected(1, 1000);
  command
      ->add_option(
          "--estimator", options->estimator,
          fmt::format("{} (default: the estimator chosen before the run, {} if none was chosen; --full "
                      "shows all)",
                      estimator_choice(), kPublishedEstimator))
      ->check(CLI::IsMember(estimator_names()));
  command->add_option("--item", options->item,
                      "of a run with several items: this one alone, from 1 (default: all of them)");
  command->add_option(
      "--stage-record", options->stage_record,
      "record of the stage (`abcal stage learn`), from which the joint estimator takes the stage");
  add_form_options(*command, options->form,
                   "print one JSON object, schema abcal.result/1; of several items abcal.tray/1");
  command->add_option(
      "--truth", options->truth,
      "compare with the simulated truth of this bench file; exit 1 beyond 4 standard uncertainties");
  command->callback([options, &exit_code] {
    options->file = fmt::format("{}", fmt::join(options->files, " "));
    if (options->files.size() > 1) {
      exit_code = show_series(*options);
      return;
    }
    std::vector<StoredRun> items = load(*options);
    const bool all = options->item == 0 && items.size() > 1;
    exit_code = all ? show_all(*options, std::move(items))
                    : show_one(*options, std::move(items), chosen_item(options->file, options->item));
  });
  return command;
}

}  // namespace abcal
