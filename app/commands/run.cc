#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/commands/campaign.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/session/run_bench.h"
#include "app/results/analysis/result_summary.h"
#include "app/results/analysis/tray_results.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

std::string timing_text(const RunTiming& t) {
  const double total = t.total_s();
  const auto part = [&](double seconds) {
    return fmt::format("{} ({:.1f} %)", describe_duration(seconds),
                       total > 0.0 ? 100.0 * seconds / total : 0.0);
  };
  return fmt::format("Time: {} = moving {} + settling {} + reading {} + overhead {}",
                     describe_duration(total), part(t.moving_s), part(t.settling_s), part(t.dwelling_s),
                     part(t.overhead_s));
}

nlohmann::ordered_json run_json(const RunOutcome& outcome) {
  const RunTiming& timing = outcome.stored().timing;
  return {{"file", outcome.path.string()},
          {"sha256", outcome.sha256.empty() ? nullptr : nlohmann::ordered_json(outcome.sha256)},
          {"state", std::string(to_string(outcome.stored().state))},
          {"timing",
           {{"moving_s", timing.moving_s},
            {"settling_s", timing.settling_s},
            {"dwelling_s", timing.dwelling_s},
            {"overhead_s", timing.overhead_s}}}};
}

std::string hash_line(const RunOutcome& outcome) {
  return fmt::format("SHA-256: {}\n", outcome.sha256.empty() ? "the file is not closed yet" : outcome.sha256);
}

}  // namespace

void print_warnings(const BenchConfig& config) {
  for (const std::string& warning : config.warnings) print_warning(warning);
}

CLI::Option* add_form_options(CLI::App& command, ResultForm& form, const std::string& about_json) {
  CLI::Option* json = command.add_flag_callback(
      "--json", [&form] { form = ResultForm::kJson; }, about_json);
  CLI::Option* full = command.add_flag_callback(
      "--full", [&form] { form = ResultForm::kFull; },
      "print everything that is known of the result, in tables as wide as they need (default: the first "
      "screen, 80 columns)");
  return full->excludes(json);
}

int print_outcome(const RunOutcome& outcome, ResultForm form) {
  if (outcome.is_levelling()) {
    print_log("A levelling, measured to its end. For its level file: abcal level --from {}\n",
              outcome.path.string());
    return kExitDone;
  }
  switch (form) {
    case ResultForm::kJson: {
      nlohmann::ordered_json output = analysis_json(outcome);
      output["run"] = run_json(outcome);
      print_result("{}\n", output.dump(2));
      break;
    }
    case ResultForm::kFull:
      print_result("{}\n{}\nFile: {}\n{}", full_text(outcome, outcome.path.string(), stdout),
                   timing_text(outcome.stored().timing), outcome.path.string(), hash_line(outcome));
      break;
    case ResultForm::kSummary:
      print_result("{}{}", summary_text(outcome, outcome.path.string(), stdout), hash_line(outcome));
      break;
  }
  const bool each_has_numbers = std::ranges::all_of(outcome.items, [](const AnalysedItem& item) {
    return !item.results.empty() && item.result().verdict != Verdict::kNotUsable;
  });
  return each_has_numbers ? kExitDone : kExitFailed;
}

RunSession::Options session_options(TerminalListener& terminal) {
  RunSession::Options options;
  options.listener = terminal.listener();
  options.stop = interrupt_token();
  options.laboratory = laboratory_link();
  return options;
}

RunSession::Options printing_session_options(TerminalListener& terminal, ResultForm form, int& exit_code) {
  RunSession::Options options = session_options(terminal);
  options.result_listener = [form, &exit_code](const RunOutcome& outcome) {
    if (outcome.measured_before) {
      print_log("All angles of {} were measured already; it is analysed now\n", outcome.path.string());
    }
    exit_code = print_outcome(outcome, form);
  };
  return options;
}

CLI::App* add_run(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    std::string output;
    bool record = false;
    ResultForm form = ResultForm::kSummary;
    bool without_missing_items = false;
    CampaignOptions campaign;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("run", "Calibrate: drive the stage through the three experiments");
  command->add_option("BENCH", options->bench_file, "bench file (TOML)")->required();
  command->add_option("-o,--output", options->output, "run file to create (default: BENCH-UTC.run here)");
  CLI::Option* record =
      command->add_flag("--record", options->record,
                        "keep every byte to and from the instruments in the run file, for `abcal replay`");
  CLI::Option* repeat =
      command
          ->add_option(
              "--repeat", options->campaign.repeat,
              "measure a campaign of this many runs, OUTPUT-1.run and so on, and report their spread")
          ->check(CLI::Range(2, 1000))
          ->excludes(record);
  command
      ->add_flag("--remount", options->campaign.remount,
                 "before each further run, wait until a person has remounted the accelerometer")
      ->needs(repeat);
  command
      ->add_flag("--go-on", options->campaign.keep_complete_runs,
                 "keep the complete runs of this campaign and measure only the missing ones")
      ->needs(repeat);
  command->add_flag("--without-missing-items", options->without_missing_items,
                    "of several items: measure the others if some are not there");
  add_form_options(*command, options->form, "print the result as one JSON object")->excludes(repeat);
  command->callback([options, &exit_code] {
    if (options->campaign.repeat > 0) {
      options->campaign.bench_file = options->bench_file;
      options->campaign.output = options->output;
      options->campaign.without_missing_items = options->without_missing_items;
      options->campaign.json = options->form == ResultForm::kJson;
      exit_code = run_campaign(options->campaign);
      return;
    }
    const BenchConfig config = read_bench(options->bench_file, register_records());
    print_warnings(config);
    TerminalListener terminal({.title = "Calibrating", .tell_how_to_resume = true});
    RunSession session(printing_session_options(terminal, options->form, exit_code));
    const std::filesystem::path path = output_path(options->output, options->bench_file, ".run");
    session.start({config, path.string(), options->record, {}, options->without_missing_items});
  });
  return command;
}

CLI::App* add_resume(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string run_file;
    ResultForm form = ResultForm::kSummary;
    bool without_missing_items = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("resume", "Continue an interrupted run");
  command->add_option("RUN", options->run_file, "run file")->required();
  command->add_flag("--without-missing-items", options->without_missing_items,
                    "of several items: continue with the others if some are not there");
  add_form_options(*command, options->form, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    TerminalListener terminal({.title = "Calibrating", .tell_how_to_resume = true});
    RunSession session(printing_session_options(terminal, options->form, exit_code));
    session.resume({options->run_file, options->without_missing_items});
  });
  return command;
}

}  // namespace abcal
