#include "app/commands/campaign.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <vector>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/commands/wait_for_enter.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/session/run_bench.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/load_record.h"
#include "app/results/report/campaign_report.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"

namespace abcal {
namespace {

std::vector<std::filesystem::path> paths_of(const CampaignOptions& options) {
  std::filesystem::path stem = output_path(options.output, options.bench_file, ".run");
  if (stem.extension() == ".run") stem.replace_extension();
  std::vector<std::filesystem::path> paths;
  for (int k = 1; k <= options.repeat; ++k) paths.push_back(fmt::format("{}-{}.run", stem.string(), k));
  return paths;
}

std::string command_to_continue(const CampaignOptions& options, const std::filesystem::path& first) {
  std::string stem = first.string();
  stem.erase(stem.size() - std::string("-1.run").size());
  return fmt::format("abcal run {} --repeat {} -o {}{} --go-on", options.bench_file, options.repeat, stem,
                     options.remount ? " --remount" : "");
}

/// Whether a run of the campaign is measured already.
/// @throws std::invalid_argument if the file is another or an incomplete run, or is not to be kept
bool is_measured(const std::filesystem::path& path, const CampaignOptions& options,
                 const BenchConfig& config) {
  if (!std::filesystem::exists(path)) return false;
  if (!options.keep_complete_runs) {
    throw std::invalid_argument(path.string() +
                                ": exists already; a run is never overwritten: choose another name with -o, "
                                "or continue a campaign that ended early with --go-on");
  }
  const StoredRun stored = RunFile::load(path);
  if (stored.header.bench_toml != write_bench(config)) {
    throw std::invalid_argument(path.string() + ": was measured with a bench file other than " +
                                options.bench_file + "; all runs of a campaign have the same bench file");
  }
  if (stored.state != RunState::kComplete) {
    throw std::invalid_argument(fmt::format("{}: is {}; finish it first: abcal resume {}", path.string(),
                                            to_string(stored.state), path.string()));
  }
  return true;
}

/// Waits for a person. @throws RunInterrupted
void ask_to_remount(int run, int runs) {
  wait_for_enter(
      fmt::format("\nRun {} of {}: the stage is at its zeros. Take the accelerometer off, mount it again, "
                  "and press Enter when nobody is touching the stage (Ctrl-C ends the campaign): ",
                  run, runs),
      "between two runs");
}

/// Prints which runs of a campaign that ends early are complete, and the command that continues it.
void tell_how_to_continue(const CampaignOptions& options, const std::vector<std::filesystem::path>& paths,
                          std::size_t failed) {
  std::vector<std::string> complete;
  for (const std::filesystem::path& path : paths) {
    std::error_code ignored;
    if (path != paths[failed] && std::filesystem::exists(path, ignored)) complete.push_back(path.string());
  }
  std::error_code ignored;
  const bool begun = std::filesystem::exists(paths[failed], ignored);
  print_log("The campaign ended in run {} of {}. Complete runs: {}. Continue with: {}{}\n", failed + 1,
            paths.size(), complete.empty() ? "none" : fmt::format("{}", fmt::join(complete, ", ")),
            begun ? fmt::format("abcal resume {}, then ", paths[failed].string()) : "",
            command_to_continue(options, paths.front()));
}

/// Measures the runs that are missing, all with the instruments opened once.
void measure_missing(const CampaignOptions& options, const BenchConfig& config,
                     const std::vector<std::filesystem::path>& paths,
                     const std::vector<std::size_t>& missing) {
  std::optional<TerminalListener> terminal;
  RunSession::Options session_options;
  session_options.listener = [&](const SessionEvent& event) { terminal->on(event); };
  session_options.stop = interrupt_token();
  session_options.laboratory = laboratory_link();
  RunSession session(std::move(session_options));
  for (const std::size_t k : missing) {
    try {
      if (options.remount && k > 0) ask_to_remount(static_cast<int>(k) + 1, options.repeat);
      terminal.emplace(TerminalListener::Options{.title = fmt::format("Run {} of {}", k + 1, paths.size()),
                                                 .introduce = k == missing.front()});
      const RunOutcome outcome = session.start({.bench = config,
                                                .run_file = paths[k].string(),
                                                .without_missing_items = options.without_missing_items});
      for (const AnalysedItem& item : outcome.items) {
        const std::string words =
            item.results.empty()
                ? item.stored.own_progress().reason
                : fmt::format("{} ({})", to_string(item.result().verdict), item.result().why);
        print_log("Run {} of {}: {}: {}\n", k + 1, paths.size(), paths[k].string(),
                  about_item(item.stored, words));
      }
    } catch (...) {
      tell_how_to_continue(options, paths, k);
      throw;
    }
  }
}

}  // namespace

int run_campaign(const CampaignOptions& options) {
  if (options.remount && !is_person_at_terminal()) {
    throw std::invalid_argument(
        "--remount: a person must confirm that the accelerometer was remounted, but standard input is not a "
        "terminal; required: a terminal, or no --remount");
  }
  const BenchConfig config = read_bench(options.bench_file, register_records());
  print_warnings(config);
  const std::vector<std::filesystem::path> paths = paths_of(options);
  std::vector<std::size_t> missing;
  for (std::size_t k = 0; k < paths.size(); ++k) {
    if (!is_measured(paths[k], options, config)) missing.push_back(k);
  }

  measure_missing(options, config, paths, missing);

  std::vector<CampaignReport> reports;  // One for each item.
  for (const std::filesystem::path& path : paths) {
    AnalysedRun run = analyse_run(RunFile::load_items(path));
    reports.resize(run.items.size());
    for (std::size_t k = 0; k < reports.size(); ++k) {
      AnalysedItem& item = run.items[k];
      reports[k].title = about_item(item.stored, fmt::format("Campaign of {} runs", paths.size()));
      reports[k].runs.push_back({path, std::move(item.results), declared_estimator(item.stored.record).name});
    }
  }
  if (options.json) {
    print_result("{}\n", campaign_json(reports).dump(2));
  } else {
    print_result("{}", campaign_text(reports, stdout));
  }
  return std::ranges::all_of(reports, &CampaignReport::usable) ? kExitDone : kExitFailed;
}

}  // namespace abcal
