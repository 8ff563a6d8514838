#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/bench/bench_config.h"
#include "app/bench/real_clock.h"
#include "app/commands/commands.h"
#include "app/results/analyses.h"
#include "app/results/estimators.h"
#include "app/results/load_record.h"
#include "app/results/other_file.h"
#include "app/results/recompute.h"
#include "app/results/result_json.h"
#include "app/results/result_text.h"
#include "app/results/tray_results.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/terminal.h"
#include "protocol/analysis/pose_import.h"
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

/// Analyses of a run to be kept; each with its item of several, from 1, else 0.
using Analyses = std::vector<std::pair<int, const CalibrationResult*>>;

/// Keeps analyses with a closed run; what cannot be kept (a read-only folder) is shown all the same.
void keep(const std::filesystem::path& path, const Analyses& analyses) {
  if (!RunFile::is_closed(path)) return;
  try {
    ResultsFile results(path, sha256_of_file(path));
    if (results.made_again()) {
      print_log("{} was missing and is created again; earlier analyses are unknown\n",
                ResultsFile::path_beside(path).string());
    }
    const std::string utc = format_utc(RealClock().utc_now());
    for (const auto& [item, result] : analyses) keep_analysis(results, utc, *result, item);
  } catch (const RunFileError& error) {
    print_log("warning: the analysis was not stored: {}\n", error.what());
  }
}

struct AnalyseOptions {
  std::string file;
  std::string estimator;
  std::string truth;
  int item = 0;
  bool json = false;
};

/// One item of several by the estimator asked for, else by the one that the run declares: joint is the common
/// fit of all items, each other one knows this item alone.
CalibrationResult result_of_item(const AnalyseOptions& options, int item) {
  const LoadedRecord loaded = load_record(options.file, item);
  const std::string estimator =
      options.estimator.empty() ? declared_estimator(loaded.record).name : options.estimator;
  if (estimator != "joint") return analyse(loaded.record, estimator);
  return std::move(analyse_tray_run(options.file).tray.items[static_cast<std::size_t>(item - 1)].result);
}

/// A run with several items. @return the exit code; nothing for a file with one item
std::optional<int> analyse_several(const AnalyseOptions& options) {
  const std::filesystem::path path = options.file;
  if (items_of_file(path) == 1) {
    if (options.item > 1) chosen_item(path, options.item);
    return std::nullopt;
  }
  if (!options.truth.empty())
    throw std::invalid_argument(
        fmt::format("--truth: {} has several items; required: a run of one", path.string()));
  if (options.item == 0 && !options.estimator.empty() && options.estimator != "joint")
    throw std::invalid_argument(fmt::format(
        "--estimator {}: {} has several items, which only the joint estimator analyses together; required: "
        "--item as well",
        options.estimator, path.string()));
  if (options.item == 0) {
    const TrayRun run = analyse_tray_run(path);
    Analyses analyses;
    for (std::size_t k = 0; k < run.tray.items.size(); ++k)
      analyses.emplace_back(static_cast<int>(k) + 1, &run.tray.items[k].result);
    keep(path, analyses);
    options.json ? print_result("{}\n", tray_json(run).dump(2)) : print_result("{}", tray_text(run, stdout));
    return run.tray.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
  }
  const int item = chosen_item(path, options.item);
  const CalibrationResult result = result_of_item(options, item);
  keep(path, {{item, &result}});
  options.json ? print_result("{}\n", result_json(result).dump(2))
               : print_result("{}", result_text(result, stdout));
  return result.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
}

}  // namespace

CLI::App* add_analyse(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<AnalyseOptions>();
  CLI::App* command = parent.add_subcommand(
      "analyse", "Sensitivity matrix, offsets and intrinsic properties of a run or CSV");
  command
      ->add_option("FILE", options->file,
                   "run file, or CSV of averaged readings (norm: of poses, or a time series)")
      ->required();
  command
      ->add_option("--estimator", options->estimator,
                   fmt::format("{} (default: the estimator chosen before the run, {} if none was chosen; the "
                               "text output shows all)",
                               estimator_choice(), kPublishedEstimator))
      ->check(CLI::IsMember(estimator_names()));
  command->add_option("--item", options->item,
                      "of a run with several items: this one alone, from 1 (default: all of them)");
  command->add_flag("--json", options->json,
                    "print one JSON object, schema abcal.result/1; of several items abcal.tray/1");
  command->add_option(
      "--truth", options->truth,
      "compare with the simulated truth of this bench file; exit 1 beyond 4 standard uncertainties");
  command->callback([options, &exit_code] {
    const std::filesystem::path path = options->file;
    if (const std::optional<int> code = analyse_several(*options)) {
      exit_code = *code;
      return;
    }
    LoadedRecord loaded;
    std::error_code error;
    if (!options->estimator.empty() && !find_estimator(options->estimator).needs_angles &&
        std::filesystem::is_regular_file(path, error) && has_no_angles(path)) {
      refuse_other_file(path, kRunOrCsv);
      loaded.record = import_poses(path).record;
    } else {
      loaded = load_record(path);
    }
    const std::string estimator =
        options->estimator.empty() ? declared_estimator(loaded.record).name : options->estimator;
    const CalibrationResult result = analyse(loaded.record, estimator);
    if (loaded.run) keep(path, {{0, &result}});
    exit_code = result.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
    if (options->json) {
      print_result("{}\n", result_json(result).dump(2));
    } else {
      if (loaded.run && loaded.run->state != RunState::kComplete) {
        print_result("{}\n", emphasised(stdout, Emphasis::kWarning,
                                        fmt::format("This run is {}: {} of {} angles are measured.",
                                                    to_string(loaded.run->state), loaded.run->measured.size(),
                                                    loaded.run->header.plan.size())));
      }
      print_result("{}", result_text(result, stdout));
      if (options->estimator.empty()) {
        print_result("\n{}\n{}", emphasised(stdout, Emphasis::kHeading, "Estimators side by side"),
                     comparison_text(analyse_all(loaded.record), estimator));
      }
    }
    if (!options->truth.empty()) {
      const TruthComparison comparison = compare_with_truth(result, read_bench(options->truth));
      std::FILE* stream = options->json ? stderr : stdout;
      const std::string heading = fmt::format("Compared with the simulated truth ({} estimator)", estimator);
      const std::string text =
          fmt::format("\n{}\n{}", emphasised(stream, Emphasis::kHeading, heading), comparison.text);
      options->json ? print_log("{}", text) : print_result("{}", text);
      if (!comparison.agrees()) exit_code = kExitFailed;
    }
  });
  return command;
}

}  // namespace abcal
