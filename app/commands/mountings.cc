#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_records.h"
#include "app/commands/analyse.h"
#include "app/commands/check.h"
#include "app/commands/combine.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/commands/wait_for_enter.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/session/mounting_series.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/terminal.h"
#include "protocol/plan/mountings.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

struct Options {
  std::string bench_file, output;
  int mountings = 0;
  bool show = false;
  ResultForm form = ResultForm::kSummary;
};

/// A mounting and how far its run is.
struct Step {
  SeriesMounting mounting;
  std::filesystem::path file;
  RunState state = RunState::kRunning;
  bool exists = false;
  bool is_done() const { return exists && state == RunState::kComplete; }
};

std::string stem_of(const Options& options) {
  std::filesystem::path stem = options.output;
  if (stem.empty()) stem = std::filesystem::path(options.bench_file).stem().string() + "-mounting";
  if (stem.extension() == ".run") stem.replace_extension();
  return stem.string();
}

/// How far the series is, from its files.
/// @throws std::invalid_argument a file of another bench
std::vector<Step> steps_of(const Options& options, const BenchConfig& config) {
  std::vector<Step> steps;
  for (SeriesMounting& mounting : mountings_of_series(config, options.mountings)) {
    Step& step = steps.emplace_back(Step{.mounting = std::move(mounting), .file = {}});
    step.file = fmt::format("{}-{}.run", stem_of(options), steps.size());
    step.exists = std::filesystem::exists(step.file);
    if (!step.exists) continue;
    const StoredRun stored = RunFile::load(step.file);
    if (stored.header.bench_toml != write_bench(step.mounting.bench))
      throw std::invalid_argument(
          fmt::format("{}: is the run of another bench file, or of another mounting, than {} has now; "
                      "required: the bench file with which the series began, or another name (-o)",
                      step.file.string(), options.bench_file));
    step.state = stored.state;
  }
  return steps;
}

std::string overview(const std::vector<Step>& steps) {
  std::string text = emphasised(stderr, Emphasis::kHeading,
                                fmt::format("{} mountings of one item, one run in each", steps.size())) +
                     "\n";
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const Step& step = steps[k];
    text += fmt::format("{:>3}  u v w along {:<10}  {:<34}  {}\n", k + 1, step.mounting.mounting,
                        step.mounting.words,
                        step.is_done() ? "measured"
                        : step.exists  ? std::string(to_string(step.state))
                                       : "to be measured");
  }
  return text;
}

/// Prints how to mount the item, and waits.
void have_mounted(const Step& step, std::size_t number, std::size_t of) {
  const SeriesMounting& mounting = step.mounting;
  const std::string what =
      fmt::format("\n{}\n\n{}\n",
                  emphasised(stderr, Emphasis::kHeading,
                             fmt::format("Mounting {} of {}: {}", number, of, mounting.words)),
                  mounting_drawing(mounting.mounting));
  if (mounting.is_simulated) {
    print_log("{}The item is simulated: it stands so now.\n", what);
    return;
  }
  wait_for_enter(
      fmt::format(
          "{}Axes of the platter with the stage at its zeros, and the outputs that point along them.\n{}"
          ", and press Enter when nobody is touching the stage (Ctrl-C ends the series; the same command "
          "goes on): ",
          what,
          step.exists ? "The run in this mounting was interrupted. The item must stand as it did"
                      : "Mount the item so"),
      "between two mountings");
}

/// Turns the stage a little and compares.
MountingJudgement check_by_gravity(RunSession& session, const StartRequest& request) {
  const Identities identities = session.identify_instruments(request);
  TerminalListener terminal(small_turn_at_terminal());
  const std::vector<TurnedItem> turned =
      measure_small_turn(*session.bench(), request.bench, identities, terminal.listener(), interrupt_token());
  terminal.finish();
  const TurnedItem& item = turned.front();
  if (!item.missing.empty()) return {false, item.missing};
  const AccelerometerInfo& info = identities.first().accelerometer;
  const ExpectedItem& expected = request.bench.items.front().expected;
  try {
    return judge_series_mounting(
        item.poses,
        {info.output_unit, nominal_response(expected, info.output_unit, request.bench.g_loc.value_mps2), {}},
        expected.mounting);
  } catch (const MountingUnclear& unclear) {
    return {false, unclear.what()};
  }
}

void measure(const Step& step, std::size_t number, std::size_t of) {
  const StartRequest request{.bench = step.mounting.bench, .run_file = step.file.string()};
  std::optional<TerminalListener> terminal;
  RunSession::Options options;
  options.listener = [&](const SessionEvent& event) {
    if (terminal) terminal->on(event);
  };
  options.stop = interrupt_token();
  options.laboratory = laboratory_link();
  RunSession session(std::move(options));
  for (;;) {
    have_mounted(step, number, of);
    const MountingJudgement judged = check_by_gravity(session, request);
    print_log("Mounting {}: {}\n", number, judged.words);
    if (judged.is_as_required) break;
    if (step.mounting.is_simulated)
      throw std::runtime_error(
          fmt::format("mounting {}: the simulated item stands otherwise: {}; look at "
                      "[stage.z] sign, [item] mounting and [simulation]",
                      number, judged.words));
  }
  terminal.emplace(TerminalListener::Options{.title = fmt::format("Mounting {} of {}", number, of),
                                             .introduce = number == 1});
  const RunOutcome outcome =
      step.exists ? session.resume({.run_file = step.file.string()}) : session.start(request);
  const CalibrationResult& result = outcome.items.front().result();
  print_log("Mounting {} of {}: {}: {} ({})\n", number, of, step.file.string(), to_string(result.verdict),
            result.why);
}

int show(const std::vector<SeriesMounting>& mountings) {
  for (std::size_t k = 0; k < mountings.size(); ++k)
    print_result("{}\n{}\n",
                 emphasised(stdout, Emphasis::kHeading,
                            fmt::format("{}  {}: mounting = \"{}\"", k + 1, mountings[k].words,
                                        mountings[k].mounting)),
                 mounting_drawing(mountings[k].mounting));
  return kExitDone;
}

int guide(const Options& options) {
  const BenchConfig config = read_bench(options.bench_file, register_records());
  if (options.show) return show(mountings_of_series(config, options.mountings));
  print_warnings(config);
  const std::vector<Step> steps = steps_of(options, config);
  const bool is_all_done = std::ranges::all_of(steps, &Step::is_done);
  if (!is_all_done && !steps.front().mounting.is_simulated && !is_person_at_terminal())
    throw std::invalid_argument(
        "mountings: a person must mount the item, but standard input is not a terminal; required: a "
        "terminal");
  print_log("{}", overview(steps));
  std::vector<std::string> files;
  for (std::size_t k = 0; k < steps.size(); ++k) {
    files.push_back(steps[k].file.string());
    if (steps[k].is_done()) continue;
    try {
      measure(steps[k], k + 1, steps.size());
    } catch (...) {
      print_log(
          "The series ended in mounting {} of {}. The same command goes on with it: abcal mountings {} "
          "--mountings {} -o {}\n",
          k + 1, steps.size(), options.bench_file, steps.size(), stem_of(options));
      throw;
    }
  }
  const std::string measurement = stem_of(options) + ".measurement";
  const int exit_code = print_measurement(combine(files, {}, measurement), measurement, options.form);
  print_log(
      "next: abcal report {0} --pdf FILE.pdf, or the record of the stage: abcal stage learn {0} -o "
      "bench.stage\n",
      measurement);
  return exit_code;
}

}  // namespace

CLI::App* add_mountings(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "mountings", "One item in several mountings: leads through its runs, ends with one result of all");
  command->add_option("BENCH", options->bench_file, "bench file (TOML)")->required();
  command->add_option("--mountings", options->mountings, "how many: 2, 3, 6 or 12")
      ->required()
      ->check(CLI::IsMember(kMountingCounts));
  command->add_option("-o,--output", options->output,
                      "name of the run files: NAME-1.run, NAME-2.run, ... (default: BENCH-mounting)");
  command->add_flag("--show", options->show, "only say and draw how the item is mounted in each run");
  add_form_options(*command, options->form, "print the result as one JSON object, schema abcal.result/1");
  command->callback([options, &exit_code] { exit_code = guide(*options); });
  return command;
}

}  // namespace abcal
