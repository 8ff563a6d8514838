#include "app/commands/simulate.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "app/bench_file/bench_config.h"
#include "app/commands/accelerometer_file.h"
#include "app/commands/simulate_calibration.h"
#include "app/commands/simulate_constant_rate.h"
#include "app/commands/simulate_joint.h"
#include "app/commands/simulate_robustness.h"
#include "app/commands/simulate_stage_records.h"
#include "app/formats/toml_reader.h"
#include "app/studies/trials/study_figures.h"
#include "app/studies/trials/study_json.h"
#include "app/studies/trials/study_text.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "app/system/real_clock.h"
#include "protocol/uncertainty/simulation_sets.h"

namespace abcal {
namespace {

void write_file(const std::filesystem::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  if (!file.flush()) throw std::runtime_error(fmt::format("{} cannot be written", path.string()));
}

}  // namespace

std::uint64_t not_negative(const char* option, std::int64_t value) {
  if (value < 0)
    throw std::invalid_argument(
        fmt::format("{} = {}; required: a number that is not negative", option, value));
  return static_cast<std::uint64_t>(value);
}

namespace {

/// --threads: 0 means as many as the machine has.
int threads_of(int threads) {
  const auto wanted = static_cast<int>(not_negative("--threads", threads));
  return wanted > 0 ? wanted : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
}

struct SimulateOptions {
  std::string set, csv, figures, aut;
  std::optional<std::int64_t> trials;
  std::int64_t seed = 1;
  int threads = 0;
  std::optional<double> alignment, step, initial_turn, zero;
  bool scale = false, resolution = false, json = false;
  JointStudyOptions joint;
  bool without_mean_step = false;
  std::int64_t benches = RobustnessOptions{}.benches;
  std::vector<std::string> scenarios, kinds;
  std::int64_t pairs = ConstantRateOptions{}.pairs;
  std::int64_t stages = StageRecordOptions{}.stages;
  bool power = false;
  std::string bench;
};

void add_common_options(CLI::App& command, SimulateOptions& options) {
  std::string sets;
  for (const std::string& name : simulation_set_names()) sets += (sets.empty() ? "" : " ") + name;
  command
      .add_option("SET", options.set,
                  "one of " + sets +
                      "; joint: the joint estimator's coverage; robustness: coverage and verdicts on benches "
                      "that break the model; stage-records: faces, mountings and records of a stage; "
                      "constant-rate: runs at a constant rate; or calibration: whether the intervals hold on "
                      "benches that are drawn from what is stated")
      ->required();
  command.add_option("--trials", options.trials, "simulations (default: as many as in the paper)");
  command.add_option("--seed", options.seed, "seed of the random numbers")->capture_default_str();
  command.add_option("--threads", options.threads, "threads; 0: one per processor (same result)");
  command.add_option("--aut", options.aut,
                     "accelerometer: JSON with sensitivity_matrix and offset, or 12 numbers");
  command.add_option("--alignment", options.alignment, "alignment of the axes, degrees");
  command.add_option("--step", options.step, "rotation-step error, degrees");
  command.add_option("--initial-turn", options.initial_turn,
                     "error of the initial -90 degree turns, degrees (abc1)");
  command.add_option("--zero", options.zero, "mean step error, degrees (abc1)");
  command.add_flag("--scale", options.scale, "sets 3 to 6: also with a tenth and ten times the misalignment");
  command.add_flag("--resolution", options.resolution,
                   "the stage's resolution of 0.001 degrees instead of its accuracy of 0.008 degrees");
  command.add_flag("--json", options.json, "print one JSON object, schema abcal.study/1");
  command.add_option("--csv", options.csv, "write the outputs of every case to this file");
  command.add_option(
      "--figures", options.figures,
      "sets 1 and 2: write figures 1 to 4 into this folder (gnuplot); calibration: those of the ranks");
}

void add_joint_options(CLI::App& command, SimulateOptions& options) {
  const auto number = [&](const char* name, double& value, const char* meaning) {
    command.add_option(name, value, meaning)->group("joint study")->capture_default_str();
  };
  number("--noise", options.joint.noise, "noise of one averaged reading, R");
  number("--nonlinearity", options.joint.k, "standard deviation of k2 and k3");
  number("--drift", options.joint.drift, "standard deviation of the drift over a run, R");
  number("--response-scale", options.joint.scale, "response units per R, e.g. 4096 for LSB");
  command.add_option("--steps", options.joint.steps, "angles of each experiment")
      ->group("joint study")
      ->capture_default_str();
  command
      .add_flag("--without-mean-step", options.without_mean_step,
                "leave the mean step errors out of the fit, to show that coverage then fails")
      ->group("joint study");
}

void add_robustness_options(CLI::App& command, SimulateOptions& options) {
  const char* const group = "robustness study";
  command
      .add_option("--benches", options.benches,
                  "simulated benches of each scenario, or of each design at a constant rate")
      ->group(group)
      ->capture_default_str();
  command
      .add_option("--scenarios", options.scenarios,
                  "only these scenarios, separated by commas (default: all)")
      ->group(group)
      ->delimiter(',');
  command
      .add_option("--pairs", options.pairs,
                  "so many items of the first design at a constant rate are measured in steps too")
      ->group("study of constant rates")
      ->capture_default_str();
  command
      .add_option("--kinds", options.kinds,
                  "only these kinds of measurement, separated by commas (default: all)")
      ->group("study of calibrations")
      ->delimiter(',');
  command
      .add_option("BENCH", options.bench,
                  "calibration: a bench file, whose measurement is then the only kind; its simulated truth "
                  "is drawn anew for each bench")
      ->group("study of calibrations");
  command
      .add_flag("--power", options.power,
                "what runs notice of effects that are 3 and 10 times as large as stated, one at a time")
      ->group("study of calibrations");
  command.add_option("--stages", options.stages, "simulated stages of each experiment")
      ->group("study of stage records")
      ->capture_default_str();
}

/// Options that a study does not read would be ignored without a word.
/// @param instead  the options that it does read
void require_not_given(const SimulateOptions& options, bool reads_tolerances, bool reads_trials,
                       const std::string& instead) {
  std::vector<std::string> given;
  const auto check = [&](bool is_given, const char* name) {
    if (is_given) given.emplace_back(name);
  };
  check(options.trials && !reads_trials, "--trials");
  check(options.alignment && !reads_tolerances, "--alignment");
  check(options.step && !reads_tolerances, "--step");
  check(options.initial_turn && !reads_tolerances, "--initial-turn");
  check(options.zero && !reads_tolerances, "--zero");
  check(!options.aut.empty(), "--aut");
  check(options.scale, "--scale");
  check(options.resolution, "--resolution");
  check(!options.csv.empty(), "--csv");
  check(!options.figures.empty(), "--figures");
  if (!given.empty())
    throw std::invalid_argument(fmt::format("simulate {}: found {}; this study reads {}", options.set,
                                            fmt::join(given, ", "), instead));
}

int run_robustness_study(const SimulateOptions& options) {
  require_not_given(options, false, false, "--benches, --scenarios, --seed, --threads and --json");
  RobustnessOptions study;
  study.benches = static_cast<int>(not_negative("--benches", options.benches));
  study.scenarios = options.scenarios;
  study.seed = not_negative("--seed", options.seed);
  study.threads = threads_of(options.threads);
  return simulate_robustness(study, options.json);
}

int run_stage_record_study(const SimulateOptions& options) {
  require_not_given(options, false, false, "--stages, --seed, --threads and --json");
  StageRecordOptions study;
  study.stages = static_cast<int>(not_negative("--stages", options.stages));
  study.seed = not_negative("--seed", options.seed);
  study.threads = threads_of(options.threads);
  return simulate_stage_records(study, options.json);
}

int run_constant_rate_study(const SimulateOptions& options) {
  require_not_given(options, false, false, "--benches, --pairs, --seed, --threads and --json");
  ConstantRateOptions study;
  study.benches = static_cast<int>(not_negative("--benches", options.benches));
  study.pairs = static_cast<int>(not_negative("--pairs", options.pairs));
  study.seed = not_negative("--seed", options.seed);
  study.threads = threads_of(options.threads);
  return simulate_constant_rate(study, options.json);
}

int run_calibrations(const SimulateOptions& options) {
  SimulateOptions others = options;
  if (!options.power) others.figures.clear();
  require_not_given(others, false, false,
                    "BENCH, --benches, --kinds, --power, --figures, --seed, --threads and --json");
  CalibrationOptions study;
  if (!options.bench.empty()) {
    if (!options.kinds.empty())
      throw std::invalid_argument("simulate calibration: found BENCH and --kinds; required: one of them");
    std::vector<Problem> problems;
    std::string text = read_text_file(options.bench, "bench file", problems);
    if (!problems.empty()) throw BenchError(options.bench, std::move(problems));
    study.bench_file = {options.bench, std::move(text)};
  }
  study.benches = static_cast<int>(not_negative("--benches", options.benches));
  study.kinds = options.kinds;
  study.seed = not_negative("--seed", options.seed);
  study.threads = threads_of(options.threads);
  return options.power ? simulate_power(study, options.json)
                       : simulate_calibration(study, options.json, options.figures);
}

int run_joint_study(const SimulateOptions& options) {
  require_not_given(options, true, true,
                    "--trials, --seed, --threads, --json, the sizes of errors in degrees, and the options "
                    "under \"joint study\"");
  JointStudyOptions study = options.joint;
  study.trials = static_cast<int>(not_negative("--trials", options.trials.value_or(study.trials)));
  study.seed = not_negative("--seed", options.seed);
  study.threads = threads_of(options.threads);
  study.joint.mean_step = !options.without_mean_step;
  const auto set_angle = [](Angle& tolerance, std::optional<double> degrees) {
    if (degrees) tolerance = Angle::degrees(*degrees);
  };
  set_angle(study.tolerances.alignment, options.alignment);
  set_angle(study.tolerances.step, options.step);
  set_angle(study.tolerances.initial_turn, options.initial_turn);
  set_angle(study.tolerances.zero, options.zero);
  return simulate_joint(study, options.json);
}

/// The options of one of the paper's sets, from the command line.
SimulationOptions simulation_of(const SimulateOptions& options) {
  SimulationOptions simulation;
  if (options.trials) simulation.trials = not_negative("--trials", *options.trials);
  simulation.seed = not_negative("--seed", options.seed);
  simulation.threads = static_cast<unsigned>(not_negative("--threads", options.threads));
  simulation.scale = options.scale;
  simulation.resolution = options.resolution;
  const auto angle = [](std::optional<double> degrees) -> std::optional<Angle> {
    if (!degrees) return std::nullopt;
    return Angle::degrees(*degrees);
  };
  simulation.alignment = angle(options.alignment);
  simulation.step = angle(options.step);
  simulation.initial_turn = angle(options.initial_turn);
  simulation.zero = angle(options.zero);
  if (!options.aut.empty()) simulation.accelerometer = read_accelerometer(options.aut);
  if (!options.figures.empty() && options.set != "1" && options.set != "2") {
    throw std::invalid_argument("--figures: figures 1 and 2 belong to set 1, 3 and 4 to set 2; set " +
                                options.set + " has none");
  }
  simulation.stop = interrupt_token();
  return simulation;
}

int run_set(const SimulateOptions& options) {
  SimulationOptions simulation = simulation_of(options);
  RealClock clock;
  ProgressBar bar("simulating", clock);
  const Clock::Instant start = clock.now();
  simulation.progress = [&](std::uint64_t done, std::uint64_t planned) {
    // No bar for studies that take less than two seconds.
    if (to_seconds(clock.now() - start) > 2.0)
      bar.show(static_cast<double>(done), static_cast<double>(planned));
  };
  const StudyResult study = run_simulation_set(options.set, simulation);
  bar.clear();
  if (!options.csv.empty()) write_file(options.csv, study_csv(study));
  if (options.json) {
    print_result("{}\n", study_json(study).dump(2));
  } else {
    print_result("{}", study_text(study));
  }
  if (!options.figures.empty()) {
    for (const std::filesystem::path& path : write_study_figures(study, options.figures)) {
      print_log("wrote {}\n", path.string());
    }
  }
  return study.interrupted ? kExitInterrupted : kExitDone;
}

}  // namespace

CLI::App* add_simulate(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<SimulateOptions>();
  CLI::App* command = parent.add_subcommand(
      "simulate", "The simulations of Geist & Gaitan (2021), compared with the printed values");
  add_common_options(*command, *options);
  add_joint_options(*command, *options);
  add_robustness_options(*command, *options);
  command->callback([options, &exit_code] {
    if (!options->bench.empty() && options->set != "calibration")
      throw std::invalid_argument(
          fmt::format("simulate {}: found {}; only `simulate calibration` reads a bench file", options->set,
                      options->bench));
    exit_code = options->set == "robustness"      ? run_robustness_study(*options)
                : options->set == "joint"         ? run_joint_study(*options)
                : options->set == "stage-records" ? run_stage_record_study(*options)
                : options->set == "constant-rate" ? run_constant_rate_study(*options)
                : options->set == "calibration"   ? run_calibrations(*options)
                                                  : run_set(*options);
  });
  return command;
}

}  // namespace abcal
