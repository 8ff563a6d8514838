#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/bench/bench_config.h"
#include "app/bench/level_file.h"
#include "app/commands/commands.h"
#include "app/commands/terminal_listener.h"
#include "app/results/analyses.h"
#include "app/results/result_text.h"
#include "app/session/run_bench.h"
#include "app/session/session_observer.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/version.h"
#include "protocol/analysis/level.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

/// Appendix A's spin about Z at Theta_X = 0, then the four positions that free the zero of X
/// (protocol/analysis/level.h).
std::vector<PlannedAngle> level_plan(const ProtocolConfig& protocol,
                                     const std::array<AxisTravel, 2>& travel) {
  std::vector<PlannedAngle> plan;
  for (const PlannedAngle& angle : make_rotation_plan(protocol, travel)) {
    // Experiment 3 turns Z through the same angles, with X at -90 degrees instead of 0.
    if (angle.experiment == 3 && !angle.closing)
      plan.push_back({0, angle.n, false, angle.alpha, Angle{}, angle.z});
  }
  const std::array<std::pair<double, double>, 4> positions{
      {{0.0, 0.0}, {0.0, 180.0}, {180.0, 180.0}, {180.0, 0.0}}};
  int n = protocol.steps;
  for (const auto& [x, z] : positions) {
    plan.push_back({0, ++n, false, Angle{}, Angle::degrees(x), Angle::degrees(z)});
  }
  return plan;
}

RunTiming measure_level_plan(const PlanMeasurement& measurement, TerminalListener& terminal) {
  FinishedEvent ended_early;
  ended_early.file = measurement.file.path().string();
  ended_early.planned = measurement.plan.size();
  terminal.begin(measurement.plan);
  SessionObserver observer([&](const SessionEvent& event) {
    if (std::holds_alternative<DwellDoneEvent>(event)) ++ended_early.measured;
    terminal.on(event);
  });
  try {
    const RunTiming timing = measure(measurement, observer, interrupt_token());
    terminal.finish();
    return timing;
  } catch (...) {
    terminal.on(ended_early);
    throw;
  }
}

}  // namespace

CLI::App* add_level(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    std::string output;
    std::string run_output;
    std::string sensitivity;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "level",
      "Measure the tilt of the Z axis and the zero of the X axis; store them with their uncertainty");
  command->add_option("BENCH", options->bench_file, "bench file (TOML)")->required();
  command->add_option(
      "-o,--output", options->output,
      "level file to write, for `level_file` under [stage] (default: BENCH-UTC.level.json here)");
  command->add_option("--run", options->run_output,
                      "file for the readings (default: BENCH-UTC.level.run here)");
  command->add_option(
      "--sensitivity", options->sensitivity,
      "run or CSV whose ABC result gives the sensitivity matrix (default: 1 in g, g_loc in m/s2)");
  command->add_flag("--json", options->json, "print one JSON object");
  command->callback([options, &exit_code] {
    const BenchConfig config = read_bench(options->bench_file);
    const std::filesystem::path output = output_path(options->output, options->bench_file, ".level.json");
    if (std::filesystem::exists(output)) {
      throw std::invalid_argument(output.string() + ": exists already; choose another name with -o");
    }
    Bench bench = make_bench(config);
    const Identities who = identify(bench, config);
    Eigen::Matrix3d s;
    if (!options->sensitivity.empty()) {
      const CalibrationResult abc = analyse(load_record(options->sensitivity).record, "abc");
      if (abc.verdict == Verdict::kNotUsable) throw std::runtime_error(options->sensitivity + ": " + abc.why);
      s = abc.sensitivity_values();
    } else if (const auto response =
                   nominal_response({}, who.accelerometer.output_unit, config.g_loc.value_mps2)) {
      s = Eigen::Matrix3d::Identity() * *response;
    } else {
      throw std::invalid_argument("the output is in " + who.accelerometer.output_unit +
                                  "; give a run of this accelerometer with --sensitivity");
    }
    std::vector<PlannedAngle> plan = level_plan(config.protocol, who.travel());
    RunFile file = RunFile::create(output_path(options->run_output, options->bench_file, ".level.run"),
                                   make_header(config, who, plan, *bench.clock));
    const std::filesystem::path run_path = file.path();
    TerminalListener terminal({.title = "Levelling"});
    const RunTiming timing = measure_level_plan({bench, config, file, plan, {}}, terminal);
    const std::string utc = format_utc(bench.clock->utc_now());
    file.close_complete(utc, timing);

    const std::vector<DwellRecord> dwells = RunFile::load(run_path).record.dwells;
    const auto spin_end = dwells.begin() + static_cast<std::ptrdiff_t>(plan.size() - 4);
    const TiltOfZ tilt = tilt_from_spin({dwells.begin(), spin_end}, s);
    const XZero x_zero = x_zero_from_reversal({spin_end, dwells.end()}, s, config.tolerances);
    LevelFile level;
    level.utc = utc;
    level.program_version = program_version();
    level.stage_serial_number = who.stage.serial_number;
    level.alignment.zx = {tilt.zx.value, tilt.zx.standard_uncertainty};
    level.alignment.zy = {tilt.zy.value, tilt.zy.standard_uncertainty};
    level.alignment.xz = {x_zero.zx_plus_xz.value - tilt.zx.value,
                          std::hypot(x_zero.zx_plus_xz.standard_uncertainty, tilt.zx.standard_uncertainty)};
    level.x_zero_deg = {x_zero.error.value, x_zero.error.standard_uncertainty};
    level.delta_z = {tilt.delta_z.value, tilt.delta_z.standard_uncertainty};
    write_level_file(output, level);
    if (options->json) {
      print_result("{}\n", level_json(level).dump(2));
    } else {
      const auto row = [](const char* name, const Quantity& q, const char* words) {
        print_result("  {:<10} {:>28} {:<7} {}\n", name, value_with_uncertainty(q), q.unit, words);
      };
      print_result("From {} angles about Z at X = 0, and the four positions of the reversal:\n",
                   plan.size() - 4);
      row("Delta_Z", tilt.delta_z, "tilt of the Z axis");
      row("Zx", tilt.zx, "its components");
      row("Zy", tilt.zy, "");
      row("Zx + Xz", x_zero.zx_plus_xz, "");
      row("X zero", x_zero.error, "actual minus commanded angle of X at 0");
      print_result(
          "Stored in {} (readings in {}). Under [stage] of a bench file, level_file = \"{}\" gives Zx, Zy "
          "and Xz to\n"
          "the joint estimator as data.\n",
          output.string(), run_path.string(), output.string());
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
