#include "app/commands/stage_try.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <stop_token>
#include <string>
#include <utility>

#include "app/bench_file/instrument_ports.h"
#include "app/bench_file/stage_description_file.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/bench/stage_trial.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/typed_line.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

struct TryOptions {
  std::string description, port, axes, units_per_degree;
  double speed_deg_per_s = 2.0;
  double move_deg = 10.0;
};

constexpr double kArrivedDeg = 0.05;
constexpr double kLongestSearchS = 600.0;

/// The scale of each axis, where the description leaves it to the bench file.
void state_scale(const TryOptions& options, const StageDescription& description, StageConfig& stage) {
  if (!description.scale_in_bench) {
    if (!options.units_per_degree.empty())
      throw std::invalid_argument("--units-per-degree: required: nothing, as the description has the scale");
    return;
  }
  const std::vector<std::string_view> numbers = pieces::split(options.units_per_degree, ',');
  const std::size_t axes = stage.z.axis.empty() ? 1 : 2;
  for (std::size_t k = 0; k < axes; ++k) {
    const auto units =
        numbers.size() == axes ? pieces::number<double>(pieces::trimmed(numbers[k])) : std::nullopt;
    if (!units || !(*units > 0.0))
      throw std::invalid_argument(fmt::format(
          "--units-per-degree: \"{}\"; required: the units of the controller in a degree of each axis, "
          "as \"{}\": the description leaves them to the bench file",
          options.units_per_degree, axes == 1 ? "1000" : "1000,1000"));
    (k == 0 ? stage.x : stage.z).units_per_degree = units;
  }
}

/// A bench with the described stage, at the slowest speed, and with an accelerometer that is simulated.
BenchConfig bench_of_trial(const TryOptions& options, const StageDescription& description) {
  BenchConfig config;
  config.name = "trial of " + description.source;
  StageConfig& stage = config.stage;
  stage.driver = kDescribed;
  stage.port = options.port.empty() ? kSimulated : options.port;
  stage.description = options.description;
  stage.description_text = description.text;
  std::vector<std::string> names = description.axis_names;
  if (!options.axes.empty()) {
    names.clear();
    for (const std::string_view name : pieces::split(options.axes, ',')) names.emplace_back(name);
  }
  if (names.empty() || names.size() > 2) {
    if (!options.axes.empty() || names.empty())
      throw std::invalid_argument("--axes: required: the names of one or two axes, as \"O,I\"");
    names.resize(2);
  }
  stage.x.axis = names[0];
  stage.z.axis = names.size() > 1 ? names[1] : "";
  state_scale(options, description, stage);
  for (StageAxisConfig* axis : {&stage.x, &stage.z}) {
    if (description.sets_speed()) axis->speed_deg_per_s = options.speed_deg_per_s;
    if (!description.wraps) continue;
    axis->wraps_deg = 360.0;
    axis->travel_min_deg = -180.0 - 3.0 * options.move_deg;
    axis->travel_max_deg = 180.0 + 3.0 * options.move_deg;
  }
  AccelerometerConfig& accelerometer = config.items.front().accelerometer;
  accelerometer.driver = accelerometer.port = kSimulated;
  return config;
}

/// A guided trial: each motion needs a yes of its own, and the halt is tried in the first.
class Trial {
 public:
  Trial(Bench& bench, const BenchConfig& config, const TryOptions& options)
      : bench_(bench), config_(config), options_(options) {}

  StageInfo carry_out() {
    // In simulated time only one thread may use the bench, and nothing real moves.
    std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
    if (!bench_.simulated_time) halt_at_once.emplace(interrupt_token(), [this] { bench_.stage->halt(); });
    const StageInfo info = bench_.stage->identify();
    print_log("identity: {} {}, serial number {}, firmware {}\n", info.maker, info.model,
              info.serial_number.empty() ? "not reported" : info.serial_number,
              info.firmware.empty() ? "not reported" : info.firmware);
    try {
      for (const StageAxis axis : kStageAxes)
        if (!name_of(axis).empty()) try_axis(axis);
    } catch (...) {
      if (!bench_.stage->halt()) print_log("the halt was not acknowledged: the stage may be moving\n");
      require_no_interrupt();  // It is the reason then.
      throw;
    }
    return info;
  }

 private:
  const std::string& name_of(StageAxis axis) const {
    return axis == StageAxis::kX ? config_.stage.x.axis : config_.stage.z.axis;
  }

  bool is_wrapped(StageAxis axis) const {
    return (axis == StageAxis::kX ? config_.stage.x : config_.stage.z).wraps_deg.has_value();
  }

  /// Asks the person; on the emulator the answer is yes.
  void require_yes(const std::string& question) const {
    if (options_.port.empty()) {
      print_log("{} yes (emulator)\n", question);
      return;
    }
    print_log("{} Type yes: ", question);
    const auto answer = typed_line();
    require_no_interrupt();
    if (answer.value_or("") != "yes") throw std::runtime_error("the trial was ended by its operator");
  }

  void require_no_interrupt() const {
    if (!bench_.simulated_time && interrupt_token().stop_requested())
      throw RunInterrupted(Message("the trial was interrupted; the description counts as not tried"));
  }

  void wait(Clock::Duration time) const {
    bench_.clock->sleep_until(bench_.clock->now() + time);
    require_no_interrupt();
  }
  double angle(StageAxis axis) const { return bench_.stage->encoder_angle(axis).deg(); }
  bool moves(StageAxis axis) const { return bench_.stage->motion_state(axis) == MotionState::kMoving; }

  [[noreturn]] static void fail(const std::string& what, const std::string& required) {
    throw InstrumentError("stage", Fault::kRefused, what + "; required: " + required);
  }

  void wait_until_stopped(StageAxis axis, double longest_s) const {
    const Clock::Instant deadline = bench_.clock->now() + from_seconds(longest_s);
    while (moves(axis)) {
      if (bench_.clock->now() > deadline)
        fail(fmt::format("axis {} still moves after {:g} s", to_string(axis), longest_s),
             "a status that says when the motion is over");
      wait(50ms);
    }
  }

  /// A motion has been commanded: it must be seen, and end by a halt.
  void try_halt(StageAxis axis) const {
    bool seen = false;
    for (int look = 0; look < 10 && !seen; ++look) {
      wait(100ms);
      seen = moves(axis);
    }
    if (!seen)
      fail(fmt::format("axis {}: no motion was seen within 1 s", to_string(axis)),
           "[status] moving that fits the replies during a motion, or a longer motion (--move-deg)");
    const HaltReport report = bench_.stage->halt_axes();
    if (report.axes[index(axis)] != AxisHalt::kHalted)
      fail("the halt was not acknowledged", "[halt] that stops all axes, and [status] stopped");
    wait(500ms);
    const double first = angle(axis);
    wait(1s);
    if (std::abs(angle(axis) - first) > kArrivedDeg)
      fail(fmt::format("axis {} turned on after the halt, by {:.3f} deg in 1 s", to_string(axis),
                       angle(axis) - first),
           "[halt] that stops all axes");
    print_log("axis {}: the halt was acknowledged, and the axis stands at {:.4f} deg\n", to_string(axis),
              first);
  }

  void try_axis(StageAxis axis) const {
    const std::string name = fmt::format("axis {} (\"{}\")", to_string(axis), name_of(axis));
    const bool searches = !bench_.stage->identify().axes[index(axis)].referenced;
    require_yes(fmt::format(
        "{}: its drive is switched on, {} begins and is halted after a moment. Is the way free{}?", name,
        searches ? "the search of the reference" : "a move",
        is_wrapped(axis) ? ", and the cable not wound" : ""));
    if (searches) {
      bench_.stage->home(axis);
    } else {
      bench_.stage->move_to(axis, Angle::degrees(angle(axis) + 2.0 * options_.move_deg));
    }
    try_halt(axis);
    if (searches) {
      require_yes(fmt::format("{}: searches its reference to the end. Is the whole travel free?", name));
      bench_.stage->home(axis);
      wait_until_stopped(axis, kLongestSearchS);
      if (!bench_.stage->identify().axes[index(axis)].referenced)
        fail(name + " has no reference after its search", "[referenced] that fits its replies");
    }
    const double from = angle(axis);
    for (const double target : {from + options_.move_deg, from}) {
      require_yes(
          fmt::format("{}: moves from {:.4f} to {:.4f} deg. Is the way free?", name, angle(axis), target));
      bench_.stage->move_to(axis, Angle::degrees(target));
      wait_until_stopped(axis, 60.0 + 10.0 * options_.move_deg / options_.speed_deg_per_s);
      if (std::abs(angle(axis) - target) > kArrivedDeg)
        fail(fmt::format("{} stopped at {:.4f} deg, commanded {:.4f} deg", name, angle(axis), target),
             fmt::format("within {:g} deg: is the scale of moves and readings the same?", kArrivedDeg));
      if (target != from)
        require_yes(
            fmt::format("{}: reading and command agree, but both may have a wrong unit. Did it turn by {:g} "
                        "deg, as seen on the stage itself?",
                        name, options_.move_deg));
    }
    print_log("{}: passed\n", name);
  }

  Bench& bench_;
  const BenchConfig& config_;
  const TryOptions& options_;
};

int try_stage(const TryOptions& options) {
  StageConfig stage;
  stage.description = options.description;
  const StageDescription description = stage_description_of(stage);
  print_log("{}: no problem found, SHA-256 {}\n", options.description, description.sha256);
  if (!options.port.empty() && ::isatty(STDIN_FILENO) != 1)
    throw std::invalid_argument(
        "--port: a person at a terminal must watch the stage; standard input is none");
  const BenchConfig config = bench_of_trial(options, description);
  BenchStreams streams;
  streams.owner = "abcal stage try";
  streams.is_trial = true;
  Bench bench = make_bench(config, std::move(streams));
  const StageInfo info = Trial(bench, config, options).carry_out();
  if (options.port.empty()) {
    print_result("{}: the description agrees with its own emulator. Next: --port PORT, with the stage\n",
                 options.description);
    return kExitDone;
  }
  StageTrial trial{description.sha256, info.maker, info.model, info.serial_number,
                   format_utc(RealClock().utc_now())};
  for (const StageAxisConfig* axis : {&config.stage.x, &config.stage.z})
    if (axis->units_per_degree) trial.units_per_degree[axis->axis] = *axis->units_per_degree;
  keep_stage_trial(trial);
  print_result("{}: passed on {}. Bench files may use it: driver = \"described\"\n", options.description,
               options.port);
  return kExitDone;
}

}  // namespace

void add_stage_try(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<TryOptions>();
  CLI::App* command = parent.add_subcommand(
      "try", "Check a description of a stage, and try it on its emulator or on the stage");
  command
      ->add_option("DESCRIPTION", options->description, "file, or the name of a description that is shipped")
      ->required();
  command->add_option("--port", options->port,
                      "port of the stage: each motion is asked for, at a slow speed; absent: the emulator");
  command->add_option("--axes", options->axes,
                      "names of one or two axes, as \"O,I\" (default: as described)");
  command->add_option(
      "--units-per-degree", options->units_per_degree,
      "units of the controller in a degree of each axis, as \"1000,1000\", where the description "
      "leaves them to the bench file");
  command->add_option("--speed-deg-per-s", options->speed_deg_per_s, "speed of the trial")
      ->check(CLI::Range(0.01, 20.0));
  command->add_option("--move-deg", options->move_deg, "length of a move")->check(CLI::Range(1.0, 80.0));
  command->callback([options, &exit_code] { exit_code = try_stage(*options); });
}

}  // namespace abcal
