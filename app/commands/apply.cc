#include <fmt/format.h>
#include <unistd.h>

#include <cmath>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "app/bench_file/bench_records.h"
#include "app/commands/apply/apply_session.h"
#include "app/commands/apply/apply_text.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/load_record.h"
#include "app/results/planner/known_bench.h"
#include "app/results/planner/plan_search.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"

namespace abcal {
namespace {

struct ApplyCommand {
  ApplyRequest request;
  std::string bench_file, frame = "item";
  bool yes = false, undo = false, json = false;
};

/// Ratio of the uncertainties of the verification to those of the run. The verification tests whether the
/// registers act as predicted, and need not be as good as the calibration.
constexpr double kCoarser = 2.0;

/// The shortest plan that verifies the result of a run.
ProtocolConfig verification_plan(const ApplyRequest& request, const BenchConfig& config) {
  const int item = chosen_item(request.run, request.item);
  const AnalysedRun run = analyse_file_by(request.run, {});
  const CalibrationResult& found = run.item(item).results.front();
  WantedValues wanted;
  double& s = wanted[static_cast<std::size_t>(PlannedOutput::kSensitivity)].emplace(0.0);
  double& offset = wanted[static_cast<std::size_t>(PlannedOutput::kOffset)].emplace(0.0);
  for (std::size_t j = 0; j < 3; ++j) {
    const double scale = found.intrinsic_sensitivity[j].value;
    s = std::max(s, kCoarser * found.intrinsic_sensitivity[j].standard_uncertainty / scale);
    offset = std::max(offset, kCoarser * found.offset[j].standard_uncertainty / scale);
  }
  if (!std::isfinite(s) || !std::isfinite(offset)) return config.protocol;
  PlanSearch search(planning_bench(config, item_of_run(run.first_run(request.run), item)),
                    PlanSearch::Tried::kSteps);
  const FoundPlan plan = search.shortest(wanted);
  return plan.plan ? plan.plan->protocol : config.protocol;
}

/// The answer of a person at the terminal; anything but "yes" or "y" is no.
bool ask_at_terminal(const std::string& question) {
  if (::isatty(STDIN_FILENO) == 0)
    throw std::invalid_argument(
        "nobody is at the terminal to be asked; required: --yes, if it is to be written without a question. "
        "Nothing was written");
  print_log("{} [yes/no] ", question);
  std::string answer;
  std::getline(std::cin, answer);
  return answer == "yes" || answer == "y";
}

int exit_code_of(const ApplyReport& report) {
  if (report.interrupted) return kExitInterrupted;
  const bool declined = !report.log.empty() && report.state == AdjustmentState::kDeclined;
  return !report.failure.empty() || declined ? kExitFailed : kExitDone;
}

int run_apply(ApplyCommand& command) {
  BenchConfig config = read_bench(command.bench_file, register_records());
  print_warnings(config);
  ApplyRequest& request = command.request;
  if (command.json && !command.yes && !request.dry_run)
    throw std::invalid_argument(
        "--json: nobody would see what is to be written; required: --yes or --dry-run");
  request.bench_file = command.bench_file;
  request.frame = command.frame == "item" ? ExportFrame::kItem : ExportFrame::kPlatter;
  if (request.as_left.empty())
    request.as_left = first_free_path(std::filesystem::path(request.run).replace_extension(".as-left.run"));
  if (!command.undo && !request.dry_run) config.protocol = verification_plan(request, config);
  request.bench = std::move(config);
  TerminalListener terminal({.title = "Verifying", .introduce = false});
  RunSession session(session_options(terminal));
  ApplySession::Options options;
  options.confirm = [&](const ApplyReport& report) {
    if (!command.json) print_result("{}", apply_text(report));
    return command.yes || ask_at_terminal(command.undo ? "Bring the old registers back?" : "Write them?");
  };
  options.progress = [](const Adjustment& adjustment) { print_log("{}\n", to_string(adjustment.state)); };
  ApplySession apply(session, options);
  const ApplyReport report = command.undo ? apply.undo(request) : apply.apply(request);
  terminal.finish();
  if (command.json)
    print_result("{}\n", apply_json(report).dump(2));
  else if (request.dry_run)
    print_result("{}Nothing was written.\n", apply_text(report));
  else
    print_result("{}", outcome_text(report));
  if (!report.failure.empty()) print_error(report.failure);
  return exit_code_of(report);
}

}  // namespace

CLI::App* add_apply(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<ApplyCommand>();
  CLI::App* command = parent.add_subcommand(
      "apply", "Write the constants of a run into the registers of its accelerometer, and verify them");
  ApplyRequest& request = options->request;
  command->add_option("RUN", request.run, "complete run of this accelerometer, or measurement of several")
      ->required();
  command->add_option("--item", request.item,
                      "of a run with several items: which one, from 1. On a bench with several it is known "
                      "by its serial number; if it reports none, it has the same number");
  command->add_option("--to", options->bench_file, "bench file (TOML) of the bench that it is on")
      ->required();
  CLI::Option* dry_run = command->add_flag("--dry-run", request.dry_run,
                                           "show old and new registers and what stays wrong; write nothing");
  CLI::Option* save =
      command->add_flag("--save", request.save, "let the instrument keep them when it is switched off");
  command->add_flag("--accept-doubtful", request.accept_doubtful,
                    "write a doubtful result too: read first why it is (such as a scale that is far off, "
                    "which is what is to be corrected)");
  command->add_flag("--yes", options->yes, "write without a question");
  CLI::Option* undo = command->add_flag(
      "--undo", options->undo, "bring back what was in the registers before the last apply of this run");
  undo->excludes(save);
  save->excludes(dry_run);
  command
      ->add_option("--label", request.label,
                   "serial number on the label of the instrument, where it does not report one")
      ->type_name("SERIAL");
  command->add_option("--estimator", request.estimator, "instead of the one that the run declares")
      ->check(CLI::IsMember(std::vector<std::string>(kEstimatorNames.begin(), kEstimatorNames.end())));
  command
      ->add_option("--frame", options->frame,
                   "axes of the corrected output: the item's own (item), or those of the stage's platter, "
                   "which corrects the mounting too (platter)")
      ->check(CLI::IsMember({"item", "platter"}))
      ->capture_default_str();
  command->add_option("-o,--output", request.as_left,
                      "run file of the verification (default: RUN.as-left.run beside the run)");
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, &exit_code] { exit_code = run_apply(*options); });
  return command;
}

}  // namespace abcal
