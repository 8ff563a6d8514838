#include <fmt/format.h>

#include <filesystem>
#include <memory>

#include "app/bench/bench_config.h"
#include "app/bench/bench_records.h"
#include "app/commands/campaign.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/results/analyses.h"
#include "app/results/result_json.h"
#include "app/results/result_text.h"
#include "app/session/register_records.h"
#include "app/session/run_bench.h"
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

/// Of several items: each by itself.
int print_items(const RunOutcome& outcome, bool json) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  bool all_usable = true;
  for (const ItemOutcome& item : outcome.items) {
    const StoredRun& stored = item.stored;
    const auto index = static_cast<std::size_t>(stored.item) - 1;
    const RunItem& identity = stored.header.items.at(index);
    nlohmann::ordered_json entry{{"k", stored.item},
                                 {"maker", identity.maker},
                                 {"model", identity.model},
                                 {"serial_number", identity.serial_number},
                                 {"result", nullptr}};
    const std::string heading =
        fmt::format("Item {}: {} (SN {})", stored.item, identity.model, identity.serial_number);
    if (!json) print_result("{}\n", emphasised(stdout, Emphasis::kHeading, heading));
    if (item.results.empty()) {
      const std::string& reason = stored.items.at(index).reason;
      all_usable = false;
      entry["dropped"] = reason;
      if (!json) print_result("not measured to the end: {}\n\n", reason);
    } else {
      const CalibrationResult& result = result_of(item.results, declared_estimator(stored.record).name);
      all_usable = all_usable && result.verdict != Verdict::kNotUsable;
      entry["result"] = result_json(result);
      if (!json) print_result("{}\n", result_text(result, stdout));
    }
    list.push_back(std::move(entry));
  }
  const std::string file = outcome.path.string();
  if (json) {
    print_result("{}\n",
                 nlohmann::ordered_json{
                     {"schema", "abcal.items/1"}, {"file", file}, {"sha256", outcome.sha256}, {"items", list}}
                     .dump(2));
  } else {
    print_result("{}\nRun file: {} ({})\n", timing_text(outcome.stored.timing), file,
                 outcome.sha256.empty() ? "not closed yet" : "SHA-256 " + outcome.sha256);
  }
  return all_usable ? kExitDone : kExitFailed;
}

}  // namespace

void print_warnings(const BenchConfig& config) {
  for (const std::string& warning : config.warnings) print_warning(warning);
}

int print_outcome(const RunOutcome& outcome, bool json) {
  if (outcome.is_levelling()) {
    print_log("A levelling, measured to its end. For its level file: abcal level --from {}\n",
              outcome.path.string());
    return kExitDone;
  }
  if (!outcome.items.empty()) return print_items(outcome, json);
  const CalibrationResult& result = outcome.result();
  const RunTiming& timing = outcome.stored.timing;
  if (json) {
    nlohmann::ordered_json output = result_json(result);
    output["run"] = {{"file", outcome.path.string()},
                     {"sha256", outcome.sha256.empty() ? nullptr : nlohmann::ordered_json(outcome.sha256)},
                     {"state", std::string(to_string(outcome.stored.state))},
                     {"timing",
                      {{"moving_s", timing.moving_s},
                       {"settling_s", timing.settling_s},
                       {"dwelling_s", timing.dwelling_s},
                       {"overhead_s", timing.overhead_s}}}};
    print_result("{}\n", output.dump(2));
  } else {
    print_result("{}\n{}\n", result_text(result, stdout),
                 emphasised(stdout, Emphasis::kHeading, "Estimators side by side"));
    print_result("{}\n{}\n", comparison_text(outcome.results, result.estimator), timing_text(timing));
    print_result("Run file: {} ({})\n", outcome.path.string(),
                 outcome.sha256.empty() ? "not closed yet" : "SHA-256 " + outcome.sha256);
  }
  return result.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
}

RunSession::Options session_options(TerminalListener& terminal) {
  RunSession::Options options;
  options.listener = terminal.listener();
  options.stop = interrupt_token();
  return options;
}

RunSession::Options printing_session_options(TerminalListener& terminal, bool json, int& exit_code) {
  RunSession::Options options = session_options(terminal);
  options.result_listener = [json, &exit_code](const RunOutcome& outcome) {
    if (outcome.measured_before) {
      print_log("All angles of {} were measured already; it is analysed now\n", outcome.path.string());
    }
    exit_code = print_outcome(outcome, json);
  };
  return options;
}

CLI::App* add_run(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    std::string output;
    bool record = false;
    bool json = false;
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
  command->add_flag("--json", options->json, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    if (options->campaign.repeat > 0) {
      options->campaign.bench_file = options->bench_file;
      options->campaign.output = options->output;
      options->campaign.json = options->json;
      exit_code = run_campaign(options->campaign);
      return;
    }
    const BenchConfig config = read_bench(options->bench_file, register_records());
    print_warnings(config);
    TerminalListener terminal({.title = "Calibrating", .tell_how_to_resume = true});
    RunSession session(printing_session_options(terminal, options->json, exit_code));
    const std::filesystem::path path = output_path(options->output, options->bench_file, ".run");
    session.start({write_bench(config),
                   options->bench_file,
                   path.string(),
                   options->record,
                   {},
                   options->without_missing_items});
  });
  return command;
}

CLI::App* add_resume(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string run_file;
    bool json = false;
    bool without_missing_items = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("resume", "Continue an interrupted run");
  command->add_option("RUN", options->run_file, "run file")->required();
  command->add_flag("--without-missing-items", options->without_missing_items,
                    "of several items: continue with the others if some are not there");
  command->add_flag("--json", options->json, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    TerminalListener terminal({.title = "Calibrating", .tell_how_to_resume = true});
    RunSession session(printing_session_options(terminal, options->json, exit_code));
    session.resume({options->run_file, options->without_missing_items});
  });
  return command;
}

}  // namespace abcal
