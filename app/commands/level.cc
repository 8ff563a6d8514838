#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/bench_file/level_file.h"
#include "app/commands/commands.h"
#include "app/commands/run.h"
#include "app/commands/terminal_listener.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/session/level_plan.h"
#include "app/measure/session/levelling.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/load_record.h"
#include "app/results/analysis/result_text.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {
namespace {

struct LevelOptions {
  std::string bench_file;
  std::string measured_run;  ///< Evaluated instead of measuring.
  std::string output;
  std::string run_output;
  std::string sensitivity;
  bool json = false;
};

/// In R per g_loc: that of the given run, or the nominal one of the output's unit.
Eigen::Matrix3d sensitivity_for(const LevelOptions& options, const std::string& output_unit,
                                double g_loc_mps2) {
  if (!options.sensitivity.empty()) {
    const CalibrationResult abc = analyse(load_record(options.sensitivity).record, "abc");
    if (abc.verdict == Verdict::kNotUsable) throw std::runtime_error(options.sensitivity + ": " + abc.why);
    return abc.sensitivity_values();
  }
  const auto nominal = nominal_sensitivity(output_unit, g_loc_mps2);
  if (!nominal) {
    throw std::invalid_argument("the output is in " + output_unit +
                                "; give a run of this accelerometer with --sensitivity");
  }
  return *nominal;
}

void print_levelling(const Levelling& levelling, std::size_t angles, const std::filesystem::path& output,
                     const std::filesystem::path& run) {
  const auto row = [](const char* name, const Quantity& q, const char* words) {
    print_result("  {:<10} {:>28} {:<7} {}\n", name, value_with_uncertainty(q), q.unit, words);
  };
  print_result("From {} angles about Z at X = 0, and the four positions of the reversal:\n",
               angles - kReversalPositions);
  row("Delta_Z", levelling.tilt.delta_z, "tilt of the Z axis");
  row("Zx", levelling.tilt.zx, "its components");
  row("Zy", levelling.tilt.zy, "");
  row("Zx + Xz", levelling.x_zero.zx_plus_xz, "");
  row("X zero", levelling.x_zero.error, "actual minus commanded angle of X at 0");
  print_result(
      "Stored in {} (readings in {}). Under [stage] of a bench file, level_file = \"{}\" gives Zx, Zy and "
      "Xz\nto the joint estimator as data.\n",
      output.string(), run.string(), output.string());
}

/// A levelling and the sensitivity in R per g_loc by which it is evaluated.
struct MeasuredLevelling {
  std::filesystem::path run_file;
  StoredRun run;
  Eigen::Matrix3d sensitivity;
};

MeasuredLevelling measure(const LevelOptions& options) {
  const BenchConfig config = read_bench(options.bench_file, register_records());
  print_warnings(config);
  const std::filesystem::path run_file = output_path(options.run_output, options.bench_file, ".level.run");
  const StartRequest request{config, run_file.string()};
  TerminalListener terminal({.title = "Levelling", .introduce = false, .tell_how_to_resume = true});
  RunSession session(session_options(terminal));
  const Identities identities = session.identify_instruments(request);
  const Eigen::Matrix3d sensitivity =
      sensitivity_for(options, identities.first().accelerometer.output_unit, config.g_loc.value_mps2);
  RunOutcome outcome = session.level(request);
  return {outcome.path, std::move(outcome.items.front().stored), sensitivity};
}

MeasuredLevelling load_levelling(const LevelOptions& options) {
  StoredRun run = RunFile::load(options.measured_run);
  const auto refuse = [&](const std::string& why) {
    throw std::invalid_argument(options.measured_run + ": " + why);
  };
  if (has_experiments(run.header.plan)) refuse("a calibration; required: a levelling, made by `abcal level`");
  if (run.state != RunState::kComplete) {
    refuse(fmt::format("{} of {} angles are measured; measure the others with: abcal resume {}",
                       run.measured.size(), run.header.plan.size(), options.measured_run));
  }
  const Eigen::Matrix3d sensitivity =
      sensitivity_for(options, run.header.response_unit, run.header.g_loc.value_mps2);
  return {options.measured_run, std::move(run), sensitivity};
}

void run_level(const LevelOptions& options) {
  const bool is_measured = !options.measured_run.empty();
  const std::filesystem::path output =
      output_path(options.output, is_measured ? options.measured_run : options.bench_file, ".level.json");
  if (std::filesystem::exists(output)) {
    throw std::invalid_argument(output.string() + ": exists already; choose another name with -o");
  }
  const MeasuredLevelling measured = is_measured ? load_levelling(options) : measure(options);
  const Levelling levelling = evaluate_levelling(measured.run, measured.sensitivity);
  const LevelFile level = level_file_of(levelling, measured.run);
  write_level_file(output, level);
  if (options.json) {
    print_result("{}\n", level_json(level).dump(2));
  } else {
    print_levelling(levelling, measured.run.record.dwells.size(), output, measured.run_file);
  }
}

}  // namespace

CLI::App* add_level(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<LevelOptions>();
  CLI::App* command = parent.add_subcommand(
      "level",
      "Measure the tilt of the Z axis and the zero of the X axis; store them with their uncertainty");
  CLI::Option_group* source = command->add_option_group("what is evaluated");
  CLI::Option* bench = source->add_option("BENCH", options->bench_file, "bench file (TOML)");
  CLI::Option* from = source->add_option(
      "--from", options->measured_run,
      "complete readings of a levelling, such as one that was continued by `abcal resume`; nothing moves");
  source->require_option(1);
  command->add_option(
      "-o,--output", options->output,
      "level file to write, for `level_file` under [stage] (default: BENCH-UTC.level.json here)");
  command
      ->add_option("--run", options->run_output, "file for the readings (default: BENCH-UTC.level.run here)")
      ->needs(bench)
      ->excludes(from);
  command->add_option(
      "--sensitivity", options->sensitivity,
      "run or CSV whose ABC result gives the sensitivity matrix (default: 1 in g, g_loc in m/s2)");
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, &exit_code] {
    run_level(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
