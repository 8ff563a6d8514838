#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/bench_file/key_reference.h"
#include "app/commands/commands.h"
#include "app/commands/plan_reach.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/results/analysis/effect_words.h"
#include "app/results/planner/known_bench.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "app/system/text_layout.h"
#include "protocol/plan/backlash.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {
namespace {

constexpr const char* kIndent = "        ";

/// The plan as `abcal plan` shows it.
struct ShownPlan {
  std::vector<PlannedAngle> angles;
  PlanDuration duration;
  std::array<AxisTravel, 2> twist;
  bool speeds_known = false;
  bool travel_assumed = false;
};

/// Output rate of the slowest item in Hz; it determines the duration of a dwell.
double slowest_rate_hz(const BenchConfig& config) {
  double slowest = config.items.front().accelerometer.settings.rate_hz;
  for (const BenchItemConfig& item : config.items)
    slowest = std::min(slowest, item.accelerometer.settings.rate_hz);
  return slowest;
}

ShownPlan make_shown_plan(const BenchConfig& config) {
  const auto [x, z] = known_axes(config);
  ShownPlan plan;
  plan.angles = make_rotation_plan(config.protocol, {x.travel, z.travel});
  plan.duration =
      estimate_duration(plan.angles, config.protocol, {x.speed, z.speed}, slowest_rate_hz(config));
  plan.twist = cable_twist(plan.angles, config.protocol);
  plan.speeds_known = x.speed.deg_per_s > 0.0 && z.speed.deg_per_s > 0.0;
  plan.travel_assumed = x.travel_assumed || z.travel_assumed;
  return plan;
}

/// Notes on the plan for the operator, each one sentence without its full stop.
std::vector<Message> plan_notes(const ShownPlan& plan, const BenchConfig& config) {
  const Tolerances& tolerances = config.items.front().tolerances;
  std::vector<Message> notes = uncovered_effects_words(tolerances, Advice::kForOperator);
  notes.insert(notes.begin(), default_effects_words(tolerances, Advice::kForOperator));
  if (backlash_is_left(config.protocol, plan.angles)) notes.push_back(backlash_words(tolerances.zero));
  std::erase(notes, Message());
  return notes;
}

nlohmann::ordered_json plan_json(const ShownPlan& plan, const BenchConfig& config) {
  const auto range = [](const AxisTravel& travel) {
    return nlohmann::ordered_json{travel.min.deg(), travel.max.deg()};
  };
  const Tolerances& tolerances = config.items.front().tolerances;
  nlohmann::ordered_json json{
      {"schema", "abcal.plan/1"},
      {"angles", nlohmann::ordered_json::array()},
      {"moving_s", plan.duration.moving_s},
      {"settling_s", plan.duration.settling_s},
      {"dwelling_s", plan.duration.dwelling_s},
      {"travel_assumed", plan.travel_assumed},
      {"estimator", config.protocol.estimator},
      {"default_effects", unstated_effects(tolerances)},
      {"notes", plan_notes(plan, config)},
      {"g_loc", {{"value_mps2", config.g_loc.value_mps2}, {"source", config.g_loc.source}}},
      {"effect_sources", nlohmann::ordered_json::object()},
      {"cable_twist_deg", {{"x", range(plan.twist[0])}, {"z", range(plan.twist[1])}}}};
  for (const BenchItemConfig& item : config.items) {
    if (!config.has_several_items()) break;
    json["items"].push_back({{"serial_number", item.item.serial_number},
                             {"driver", item.accelerometer.driver},
                             {"port", item.accelerometer.port},
                             {"rate_hz", item.accelerometer.settings.rate_hz},
                             {"mounting", item.expected.mounting}});
  }
  for (const auto& [key, source] : tolerances.sources) json["effect_sources"][key] = source;
  for (const PlannedAngle& angle : plan.angles) {
    json["angles"].push_back({{"experiment", angle.experiment},
                              {"n", angle.n},
                              {"face", angle.face},
                              {"closing", angle.closing},
                              {"check", angle.check},
                              {"alpha_deg", angle.alpha.deg()},
                              {"x_deg", angle.x.deg()},
                              {"z_deg", angle.z.deg()}});
    if (angle.sweep == 0) continue;
    json["angles"].back()["sweep"] = angle.sweep;
    json["angles"].back()["rate_deg_per_s"] = angle.rate_deg_per_s;
  }
  return json;
}

void print_angles(const std::vector<PlannedAngle>& angles) {
  print_result("{:>5} {:>10} {:>5} {:>10} {:>10} {:>10}\n", "", "experiment", "n", "alpha/deg", "X/deg",
               "Z/deg");
  for (std::size_t k = 0; k < angles.size(); ++k) {
    const PlannedAngle& angle = angles[k];
    print_result("{:>5} {:>10} {:>5} {:>10g} {:>10g} {:>10g}{}{}{}\n", k + 1, angle.experiment, angle.n,
                 angle.alpha.deg(), angle.x.deg(), angle.z.deg(), angle.face == 2 ? "  face 2" : "",
                 angle.sweep > 0 ? fmt::format("  at {:g} deg/s", angle.rate_deg_per_s) : "",
                 angle.closing ? "  closing angle"
                 : angle.check ? "  check pose"
                               : "");
  }
}

/// "about 1 h 00 min", or without the moves where their speed is not known.
std::string duration_words(const ShownPlan& plan) {
  const std::string total = describe_duration(plan.duration.total_s());
  return plan.speeds_known ? "about " + total : fmt::format("about {} and the moves", total);
}

void print_duration(const ShownPlan& plan) {
  const PlanDuration& duration = plan.duration;
  const std::string settling = describe_duration(duration.settling_s);
  const std::string reading = describe_duration(duration.dwelling_s);
  const std::string moving = plan.speeds_known ? "moving " + describe_duration(duration.moving_s)
                                               : "moving unknown (no speed_deg_per_s in the bench file)";
  print_result("{}", wrapped(fmt::format("{}, settling {}, reading {}", moving, settling, reading),
                             "Time:   ", kIndent, kTerminalColumns));
}

/// The instruments of the bench: "stage pi_gcs on /dev/ttyUSB0".
void print_instruments(const BenchConfig& config) {
  const auto on = [](const std::string& driver, const std::string& port) {
    return port.empty() ? driver : fmt::format("{} on {}", driver, port);
  };
  const auto print = [](const std::string& name, const std::string& words) {
    print_result("{}", wrapped(printable_line(words), name, kIndent, kTerminalColumns, LongWords::kBreak));
  };
  print("Stage:  ", on(config.stage.driver, config.stage.port));
  for (std::size_t k = 0; k < config.items.size(); ++k) {
    const BenchItemConfig& item = config.items[k];
    std::string words = fmt::format(
        "{} {}, serial number {}; {}, {:g} readings/s", item.item.maker, item.item.model,
        item.item.serial_number.empty() ? "not stated" : item.item.serial_number,
        on(item.accelerometer.driver, item.accelerometer.port), item.accelerometer.settings.rate_hz);
    print("Item:   ", config.has_several_items() ? fmt::format("{}: {}", k + 1, words) : words);
  }
}

/// Local gravity and effects that come from records of the register, or are stated.
void print_sources(const BenchConfig& config) {
  if (!config.g_loc.source.empty())
    print_result("Local gravity {:.9g} m/s2: {}\n", config.g_loc.value_mps2, config.g_loc.source);
  const Tolerances& tolerances = config.items.front().tolerances;
  for (const EffectSizeKey& key : effect_size_keys()) {
    const auto source = tolerances.sources.find(key.key);
    if (source == tolerances.sources.end() || source->second == "stated") continue;
    print_result("{}: u = {:.4g} {}: {}\n", key.key, key.get(tolerances), key.unit, source->second);
  }
}

/// "1000 readings at each"; where the stage turns, the rates at which it passes them.
std::string readings_words(const BenchConfig& config) {
  const ProtocolConfig& protocol = config.protocol;
  if (protocol.is_constant_rate())
    return fmt::format("passed at {:g} deg/s, up and down in turn", fmt::join(protocol.rate_deg_per_s, ", "));
  return fmt::format("{} readings at each",
                     readings_per_dwell(protocol, config.items.front().accelerometer.settings.rate_hz));
}

/// The first screen: no problem, instruments, angles, time, travel of the axes, and what is not stated.
void print_plan(const ShownPlan& plan, const BenchConfig& config, const std::string& bench_file) {
  print_result("{}", wrapped(fmt::format("No problem: {} angles, {}, {} estimator", plan.angles.size(),
                                         duration_words(plan), config.protocol.estimator),
                             "", "  ", kTerminalColumns));
  print_instruments(config);
  print_result("Angles: {}; {}{}\n", plan.angles.size(), readings_words(config),
               config.has_several_items() ? fmt::format(", of {} items", config.items.size()) : "");
  print_duration(plan);
  print_result("{}",
               wrapped(fmt::format("wound from {:g} to {:g} deg about X and from {:g} to {:g} deg about Z, "
                                   "relative to zero, where the stage is parked; limits: travel_min_deg, "
                                   "travel_max_deg",
                                   plan.twist[0].min.deg(), plan.twist[0].max.deg(), plan.twist[1].min.deg(),
                                   plan.twist[1].max.deg()),
                       "Cables: ", kIndent, kTerminalColumns));
  if (plan.travel_assumed)
    print_result("        No travel is given: -360 to 360 deg is assumed; `run` asks the stage.\n");
  const Tolerances& tolerances = config.items.front().tolerances;
  const std::string full = fmt::format("abcal plan {} --full", bench_file);
  const Message defaults = default_effects_words(tolerances, Advice::kForOperator);
  for (const Message& note : plan_notes(plan, config)) {
    // The cost of each default is known after the run; here their number is enough.
    const bool of_defaults = note == defaults;
    const std::string words =
        of_defaults ? fmt::format("{} sizes of effects are defaults that nobody stated (docs/effects.md)",
                                  unstated_effects(tolerances).size())
                    : note.english();
    print_result("{}", wrapped(words, "Note:   ", kIndent, kTerminalColumns));
    if (of_defaults) print_result("{}-> {}\n", kIndent, full);
  }
  print_result("Every angle, and where each value comes from: {}\n", full);
}

/// All that the first screen leaves out: the notes as they are, the sources of values, every angle.
void print_rest(const ShownPlan& plan, const BenchConfig& config) {
  print_result("\n");
  for (const Message& note : plan_notes(plan, config)) print_result("Note: {}.\n", note);
  print_sources(config);
  print_angles(plan.angles);
}

}  // namespace

CLI::App* add_plan(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    bool json = false;
    bool full = false;
    bool keys = false;
    ReachOptions reach;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("plan", "Show the sequence and its duration, or every problem of the bench file");
  CLI::Option* bench = command->add_option("BENCH", options->bench_file, "bench file (TOML)");
  CLI::Option* json = command->add_flag("--json", options->json, "print one JSON object");
  command->add_flag("--full", options->full, "print every angle too, and where each stated value comes from")
      ->excludes(json);
  command->add_flag("--keys", options->keys, "print the reference of all keys of a bench file (Markdown)")
      ->excludes(bench);
  add_reach_options(*command, options->reach);
  command->callback([options, &exit_code] {
    exit_code = kExitDone;
    if (options->keys) {
      print_result("{}", bench_file_page());
      return;
    }
    if (options->bench_file.empty()) throw CLI::RequiredError("BENCH");
    const BenchConfig config = read_bench(options->bench_file, register_records());
    for (const std::string& warning : config.warnings) print_warning(warning);
    if (options->reach.has_details() && !options->reach.asked())
      throw CLI::ValidationError(
          "--noise, --estimator, --others, --plot and --write go with --reach or --time");
    if (options->reach.asked()) {
      options->reach.bench_file = options->bench_file;
      options->reach.json = options->json;
      exit_code = run_reach(options->reach, planning_bench(config, {}));
      return;
    }
    const ShownPlan plan = make_shown_plan(config);
    if (options->json) {
      print_result("{}\n", plan_json(plan, config).dump(2));
    } else {
      print_plan(plan, config, options->bench_file);
      if (options->full) print_rest(plan, config);
    }
  });
  return command;
}

}  // namespace abcal
