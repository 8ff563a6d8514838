#include <fmt/chrono.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <ctime>
#include <set>

#include "app/analyses.h"
#include "app/bench_config.h"
#include "app/commands/commands.h"
#include "app/exit_code.h"
#include "app/interrupt.h"
#include "app/make_bench.h"
#include "app/progress.h"
#include "app/real_clock.h"
#include "app/report/result_json.h"
#include "app/report/result_text.h"
#include "app/terminal.h"
#include "app/version.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/run/experiment_run.h"

namespace abcal {
namespace {

/// Shows a run on the terminal's last line.
class TerminalObserver final : public RunObserver {
 public:
  TerminalObserver(const std::vector<PlannedAngle>& plan, std::size_t already_measured)
      : plan_(plan), measured_(already_measured), bar_("Calibrating", clock_) {}

  void phase(std::size_t position, RunPhase phase) override {
    std::string words(to_string(phase));
    if (position < plan_.size() && phase != RunPhase::kHoming && phase != RunPhase::kWarmingUp) {
      const PlannedAngle& angle = plan_[position];
      words += fmt::format(", experiment {}, alpha = {:g} deg", angle.experiment, angle.alpha.deg());
    }
    bar_.show(static_cast<double>(measured_), static_cast<double>(plan_.size()), words);
  }
  void dwell(std::size_t, const DwellRecord&) override { ++measured_; }
  void notice(std::string_view text) override {
    bar_.line(emphasised(stderr, Emphasis::kWarning, fmt::format("flag: {}", text)));
  }
  void finish() { bar_.clear(); }
  std::size_t measured() const { return measured_; }

 private:
  RealClock clock_;  // People live in real time, also when the run's time is simulated.
  const std::vector<PlannedAngle>& plan_;
  std::size_t measured_;
  ProgressBar bar_;
};

InstrumentIdentity identity(const StageInfo& info) {
  std::string details;
  for (const StageAxis axis : kStageAxes) {
    const StageAxisInfo& a = info.axes[index(axis)];
    details += fmt::format("{}axis {}: {} travel {:g} to {:g} deg, speed {:g} deg/s, resolution {:g} deg",
                           details.empty() ? "" : "; ", to_string(axis), a.stage_name, a.travel_min.deg(),
                           a.travel_max.deg(), a.speed_deg_per_s, a.resolution.deg());
  }
  return {"stage", info.maker, info.model, info.serial_number, info.firmware, details};
}

InstrumentIdentity identity(const AccelerometerInfo& info) {
  std::string details = fmt::format("output in {}, {:g} readings/s", info.output_unit, info.rate_hz);
  if (info.full_scale) details += fmt::format(", full scale {:g} {}", *info.full_scale, info.output_unit);
  return {"accelerometer", info.maker, info.model, info.serial_number, info.firmware, details};
}

void require_serial_number(const std::string& role, const std::string& model, const std::string& found,
                           const std::string& required) {
  if (required.empty() || found == required) return;
  throw InstrumentError(
      role + " " + model, Fault::kWrongIdentity,
      fmt::format("serial number {}; required: {} (serial_number in the bench file). Connect the "
                  "right one, or name its port by usb:VID:PID:SERIAL",
                  found.empty() ? "not told" : found, required));
}

/// What the instruments said before the first move.
struct Identities {
  StageInfo stage;
  AccelerometerInfo accelerometer;
};

Identities identify(Bench& bench, const BenchConfig& config) {
  Identities who{bench.stage->identify(), bench.accelerometer->identify()};
  require_serial_number("stage", who.stage.model, who.stage.serial_number, config.stage.serial_number);
  require_serial_number("accelerometer", who.accelerometer.model, who.accelerometer.serial_number,
                        config.accelerometer.serial_number);
  const std::string& unit = config.accelerometer.response_unit;
  if (!unit.empty() && config.accelerometer.driver != "simulated" && unit != who.accelerometer.output_unit) {
    throw InstrumentError("accelerometer " + who.accelerometer.model, Fault::kWrongIdentity,
                          fmt::format("its output is in {}; required: {} ([accelerometer] response_unit)",
                                      who.accelerometer.output_unit, unit));
  }
  return who;
}

std::array<AxisTravel, 2> travel_of(const StageInfo& info) {
  return {AxisTravel{info.axes[0].travel_min, info.axes[0].travel_max},
          AxisTravel{info.axes[1].travel_min, info.axes[1].travel_max}};
}

RunHeader make_header(const BenchConfig& config, const Identities& who, std::vector<PlannedAngle> plan,
                      const Clock& clock) {
  RunHeader header;
  header.program_version = program_version();
  header.created_utc = format_utc(clock.utc_now());
  header.bench_toml = write_bench(config);
  const auto label = [&](const std::string& key, const std::string& value) {
    if (!value.empty()) header.labels[key] = value;
  };
  label("bench.name", config.name);
  label("operator.name", config.operator_name);
  label("item.maker", config.item.maker);
  label("item.model", config.item.model);
  label("item.serial_number", config.item.serial_number);
  label("item.range", config.item.range);
  label("item.filter", config.item.filter);
  label("item.firmware", config.item.firmware);
  label("item.supply", config.item.supply);
  header.instruments = {identity(who.stage), identity(who.accelerometer)};
  header.response_unit = who.accelerometer.output_unit;
  header.g_loc = config.g_loc;
  header.tolerances = config.tolerances;
  header.step = config.protocol.step;
  header.steps = config.protocol.steps;
  header.plan = std::move(plan);
  return header;
}

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

/// Measures what is missing, closes the run, analyses and prints. Shared by run and resume.
int measure_and_report(Bench& bench, const BenchConfig& config, RunFile file,
                       const std::vector<PlannedAngle>& plan, const std::set<std::size_t>& measured,
                       const RunTiming& spent, bool json) {
  const std::filesystem::path path = file.path();
  TerminalObserver observer(plan, measured.size());
  RunTiming timing;
  try {
    // In real time the watching thread halts the stage at once, also while this thread waits for a reply.
    // Simulated time has one thread only.
    std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
    if (!bench.simulated_time) {
      halt_at_once.emplace(interrupt_token(), [&] { bench.stage->halt(); });
    }
    timing = run_experiments({*bench.stage, *bench.accelerometer, *bench.clock}, plan, measured,
                             config.protocol, config.limits, spent, file, observer, interrupt_token());
  } catch (...) {
    observer.finish();
    fmt::print(
        stderr,
        "The stage was halted. {} of {} angles are measured and kept in {}; go on with: abcal resume {}\n",
        observer.measured(), plan.size(), path.string(), path.string());
    throw;
  }
  observer.finish();
  const std::string utc = format_utc(bench.clock->utc_now());
  file.append_environment(utc, "end", config.environment.temperature_degc,
                          config.environment.humidity_percent, config.environment.pressure_hpa);
  const std::string sha256 = file.close_complete(utc);

  const StoredRun stored = RunFile::load(path);
  const std::vector<CalibrationResult> results = analyse_all(stored.record);
  const CalibrationResult& result = results.front();
  ResultsFile results_file(path, sha256);
  for (const CalibrationResult& each : results) {
    results_file.add_analysis(utc, program_version(), each.estimator, result_json(each).dump());
  }
  if (json) {
    nlohmann::ordered_json output = result_json(result);
    output["run"] = {{"file", path.string()},
                     {"sha256", sha256},
                     {"state", std::string(to_string(stored.state))},
                     {"timing",
                      {{"moving_s", timing.moving_s},
                       {"settling_s", timing.settling_s},
                       {"dwelling_s", timing.dwelling_s},
                       {"overhead_s", timing.overhead_s}}}};
    fmt::print("{}\n", output.dump(2));
  } else {
    fmt::print("{}\n{}\n", result_text(result, stdout),
               emphasised(stdout, Emphasis::kHeading, "Estimators side by side"));
    fmt::print("{}\n{}\n", comparison_text(results), timing_text(timing));
    fmt::print("Run file: {} (SHA-256 {})\n", path.string(), sha256);
  }
  return result.verdict == Verdict::kNotUsable ? kExitFailed : kExitDone;
}

std::filesystem::path default_run_path(const std::string& bench_file) {
  // The name carries real time also when the run's time is simulated: two dry runs are two files.
  const std::time_t now = std::time(nullptr);
  return fmt::format("{}-{:%Y%m%dT%H%M%SZ}.run", std::filesystem::path(bench_file).stem().string(),
                     fmt::gmtime(now));
}

void print_warnings(const BenchConfig& config) {
  for (const std::string& warning : config.warnings) spdlog::warn("{}", warning);
}

}  // namespace

CLI::App* add_run(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    std::string output;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("run", "Calibrate: drive the stage through the three experiments");
  command->add_option("BENCH", options->bench_file, "bench file (TOML)")->required();
  command->add_option("-o,--output", options->output, "run file to create (default: BENCH-UTC.run here)");
  command->add_flag("--json", options->json, "print the result as one JSON object");
  command->callback([options, &exit_code] {
    const BenchConfig config = read_bench(options->bench_file);
    print_warnings(config);
    Bench bench = make_bench(config);
    const Identities who = identify(bench, config);
    std::vector<PlannedAngle> plan = make_rotation_plan(config.protocol, travel_of(who.stage));
    const std::filesystem::path path = options->output.empty() ? default_run_path(options->bench_file)
                                                               : std::filesystem::path(options->output);
    const PlanDuration estimate = estimate_duration(
        plan, config.protocol, {who.stage.axes[0].speed_deg_per_s, who.stage.axes[1].speed_deg_per_s},
        who.accelerometer.rate_hz);
    fmt::print(
        stderr,
        "Stage: {} {} (SN {})\nAccelerometer: {} {} (SN {}), {:g} readings/s in {}\n{} angles, about {}{}\n",
        who.stage.maker, who.stage.model, who.stage.serial_number, who.accelerometer.maker,
        who.accelerometer.model, who.accelerometer.serial_number, who.accelerometer.rate_hz,
        who.accelerometer.output_unit, plan.size(), describe_duration(estimate.total_s()),
        bench.simulated_time ? " of simulated time (nothing real takes part)" : "");
    RunFile file = RunFile::create(path, make_header(config, who, plan, *bench.clock));
    const std::string utc = format_utc(bench.clock->utc_now());
    file.append_event(utc, "started", "run started");
    file.append_environment(utc, "start", config.environment.temperature_degc,
                            config.environment.humidity_percent, config.environment.pressure_hpa);
    exit_code = measure_and_report(bench, config, std::move(file), plan, {}, {}, options->json);
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
    RunFile file = RunFile::open_for_append(options->run_file);
    const StoredRun stored = RunFile::load(options->run_file);
    const BenchConfig config = parse_bench(stored.header.bench_toml, options->run_file);
    Bench bench = make_bench(config);
    const Identities who = identify(bench, config);
    for (const auto& [role, serial] : {std::pair{"stage", who.stage.serial_number},
                                       std::pair{"accelerometer", who.accelerometer.serial_number}}) {
      for (const InstrumentIdentity& before : stored.header.instruments) {
        if (before.role == role) require_serial_number(role, before.model, serial, before.serial_number);
      }
    }
    const std::set<std::size_t> measured(stored.measured.begin(), stored.measured.end());
    file.set_state(
        RunState::kRunning, format_utc(bench.clock->utc_now()),
        fmt::format("resumed with {} of {} angles measured", measured.size(), stored.header.plan.size()));
    exit_code = measure_and_report(bench, config, std::move(file), stored.header.plan, measured,
                                   stored.timing, options->json);
  });
  return command;
}

}  // namespace abcal
