#include <fmt/format.h>

#include <algorithm>
#include <ctime>
#include <set>

#include "app/bench/bench_config.h"
#include "app/bench/transcript.h"
#include "app/commands/campaign.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/results/analyses.h"
#include "app/results/result_json.h"
#include "app/results/result_text.h"
#include "app/session/run_bench.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "app/system/terminal.h"
#include "app/system/version.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/run/experiment_run.h"

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

/// The instruments could not be identified, so there is no run; but what they said is worth keeping.
void keep_recording_without_run(BenchConfig config, const Clock& clock, const std::filesystem::path& path,
                                Transcript& transcript, std::string_view why) {
  try {
    config.stage.level_file.clear();  // Only an identified stage can be compared with it.
    RunHeader header = make_header(config, {}, {}, clock);
    header.instruments.clear();
    RunFile file = RunFile::create(path, header);
    transcript.keep_in(file);
    file.set_state(RunState::kAbandoned, format_utc(clock.utc_now()), why);
    print_log("Nothing was measured; the recording is kept in {}\n", path.string());
  } catch (const RunFileError& error) {
    print_log("The recording is lost: {}\n", error.what());
  }
}

}  // namespace

void print_warnings(const BenchConfig& config) {
  for (const std::string& warning : config.warnings) print_warning(warning);
}

std::vector<PlannedAngle> plan_and_introduce(const Bench& bench, const BenchConfig& config,
                                             const Identities& who) {
  std::vector<PlannedAngle> plan = make_rotation_plan(config.protocol, who.travel());
  const PlanDuration estimate = estimate_duration(
      plan, config.protocol, {who.stage.axes[0].speed_deg_per_s, who.stage.axes[1].speed_deg_per_s},
      who.accelerometer.rate_hz);
  print_log(
      "Stage: {} {} (SN {})\nAccelerometer: {} {} (SN {}), {:g} readings/s in {}\n{} angles, about {}{}\n",
      who.stage.maker, who.stage.model, who.stage.serial_number, who.accelerometer.maker,
      who.accelerometer.model, who.accelerometer.serial_number, who.accelerometer.rate_hz,
      who.accelerometer.output_unit, plan.size(), describe_duration(estimate.total_s()),
      bench.simulated_time ? " of simulated time (nothing real takes part)" : "");
  return plan;
}

RunFile begin_run(Bench& bench, const BenchConfig& config, const Identities& who,
                  const std::vector<PlannedAngle>& plan, const std::filesystem::path& path,
                  Transcript* transcript) {
  RunFile file = RunFile::create(path, make_header(config, who, plan, *bench.clock));
  if (transcript != nullptr) transcript->keep_in(file);
  file.append_event(format_utc(bench.clock->utc_now()), "started", "run started");
  note_environment(bench, config, file, "start");
  return file;
}

InterruptedRun open_interrupted_run(const std::filesystem::path& path) {
  RunFile file = RunFile::open_for_append(path);
  StoredRun stored = RunFile::load(path);
  RunProgress so_far;
  so_far.measured = {stored.measured.begin(), stored.measured.end()};
  so_far.spent = stored.timing;
  if (!stored.measured.empty()) {
    const std::vector<DwellRecord>& dwells = stored.record.dwells;
    const auto last = std::find_if(dwells.rbegin(), dwells.rend(), can_be_compared_with);
    if (last != dwells.rend()) {
      so_far.last = {stored.measured[static_cast<std::size_t>(dwells.rend() - last) - 1], *last};
    }
    so_far.first_temperature_degc = stored.record.dwells.front().temperature_degc;
  }
  BenchConfig config = parse_bench(stored.header.bench_toml, path.string());
  return {std::move(file), std::move(stored), std::move(config), std::move(so_far)};
}

void continue_run(InterruptedRun& run, Bench& bench) {
  const Identities who = identify(bench, run.config);
  for (const auto& [role, serial] : {std::pair{"stage", who.stage.serial_number},
                                     std::pair{"accelerometer", who.accelerometer.serial_number}}) {
    for (const InstrumentIdentity& before : run.stored.header.instruments) {
      if (before.role == role) require_serial_number(role, before.model, serial, before.serial_number);
    }
  }
  run.file.set_state(RunState::kRunning, format_utc(bench.clock->utc_now()),
                     fmt::format("resumed with {} of {} angles measured", run.so_far.measured.size(),
                                 run.stored.header.plan.size()));
}

FinishedRun analyse_closed_run(const std::filesystem::path& path, const std::string& sha256,
                               const std::string& utc) {
  FinishedRun run;
  run.sha256 = sha256;
  run.stored = RunFile::load(path);
  run.results = analyse_all(run.stored.record);
  ResultsFile results_file(path, sha256);
  for (const CalibrationResult& each : run.results) {
    results_file.add_analysis(utc, program_version(), each.estimator, result_json(each).dump());
  }
  return run;
}

std::optional<FinishedRun> finish_killed_run(const std::filesystem::path& path) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored) || RunFile::load(path).state != RunState::kComplete)
    return std::nullopt;
  const std::string sha256 = RunFile::finish_closing(path);
  if (ResultsFile(path, sha256).analyses() >= kEstimators.size()) return std::nullopt;
  return analyse_closed_run(path, sha256, format_utc(RealClock().utc_now()));
}

FinishedRun finish_run(Bench& bench, const BenchConfig& config, RunFile file, const RunTiming& timing) {
  const std::filesystem::path path = file.path();
  const std::string utc = format_utc(bench.clock->utc_now());
  note_environment(bench, config, file, "end");
  return analyse_closed_run(path, file.close_complete(utc, timing), utc);
}

namespace {

/// @return what the program shall return to the shell.
int print_finished_run(const std::filesystem::path& path, const FinishedRun& run, bool json) {
  const CalibrationResult& result = run.results.front();
  const RunTiming& timing = run.stored.timing;
  if (json) {
    nlohmann::ordered_json output = result_json(result);
    output["run"] = {{"file", path.string()},
                     {"sha256", run.sha256},
                     {"state", std::string(to_string(run.stored.state))},
                     {"timing",
                      {{"moving_s", timing.moving_s},
                       {"settling_s", timing.settling_s},
                       {"dwelling_s", timing.dwelling_s},
                       {"overhead_s", timing.overhead_s}}}};
    print_result("{}\n", output.dump(2));
  } else {
    print_result("{}\n{}\n", result_text(result, stdout),
                 emphasised(stdout, Emphasis::kHeading, "Estimators side by side"));
    print_result("{}\n{}\n", comparison_text(run.results), timing_text(timing));
    print_result("Run file: {} (SHA-256 {})\n", path.string(), run.sha256);
  }
  return result.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
}

}  // namespace

int measure_and_report(Bench& bench, const BenchConfig& config, RunFile file,
                       const std::vector<PlannedAngle>& plan, const RunProgress& so_far, bool json) {
  const std::filesystem::path path = file.path();
  const RunTiming timing =
      measure(bench, config, file, plan, so_far, bench.replayed ? "Replaying" : "Calibrating",
              bench.replayed ? "" : "; go on with: abcal resume " + path.string());
  return print_finished_run(path, finish_run(bench, config, std::move(file), timing), json);
}

CLI::App* add_run(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    std::string output;
    bool record = false;
    bool json = false;
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
          ->add_option("--repeat", options->campaign.repeat,
                       "a campaign of so many runs, OUTPUT-1.run and so on, and their spread")
          ->check(CLI::Range(2, 1000))
          ->excludes(record);
  command
      ->add_flag("--remount", options->campaign.remount,
                 "between the runs, wait until a person has remounted the accelerometer")
      ->needs(repeat);
  command
      ->add_flag("--go-on", options->campaign.go_on,
                 "keep the runs of the campaign that are complete already")
      ->needs(repeat);
  command->add_flag("--json", options->json, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    if (options->campaign.repeat > 0) {
      options->campaign.bench_file = options->bench_file;
      options->campaign.output = options->output;
      options->campaign.json = options->json;
      exit_code = run_campaign(options->campaign);
      return;
    }
    const BenchConfig config = read_bench(options->bench_file);
    print_warnings(config);
    const std::filesystem::path path = output_path(options->output, options->bench_file, ".run");
    Transcript transcript(interrupt_token());
    Bench bench = make_bench(config, options->record ? transcript.streams() : BenchStreams{});
    if (options->record && !transcript.has_streams()) {
      throw std::invalid_argument(
          "--record: nothing on this bench has bytes to record, its drivers are simulated without a wire; "
          "required: at least one other driver (its port may be \"simulated\")");
    }
    Identities who;
    try {
      who = identify(bench, config);
    } catch (const InstrumentError& error) {
      if (options->record) keep_recording_without_run(config, *bench.clock, path, transcript, error.what());
      throw;
    }
    const std::vector<PlannedAngle> plan = plan_and_introduce(bench, config, who);
    RunFile file = begin_run(bench, config, who, plan, path, options->record ? &transcript : nullptr);
    exit_code = measure_and_report(bench, config, std::move(file), plan, {}, options->json);
  });
  return command;
}

CLI::App* add_resume(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string run_file;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("resume", "Go on with an interrupted run");
  command->add_option("RUN", options->run_file, "run file")->required();
  command->add_flag("--json", options->json, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    if (const auto finished = finish_killed_run(options->run_file)) {
      print_log("All angles of {} were measured already; it is analysed now\n", options->run_file);
      exit_code = print_finished_run(options->run_file, *finished, options->json);
      return;
    }
    InterruptedRun run = open_interrupted_run(options->run_file);
    Bench bench = make_bench(run.config);
    continue_run(run, bench);
    exit_code = measure_and_report(bench, run.config, std::move(run.file), run.stored.header.plan, run.so_far,
                                   options->json);
  });
  return command;
}

}  // namespace abcal
