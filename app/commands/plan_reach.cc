#include "app/commands/plan_reach.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "app/document/gnuplot.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/results/planner/known_bench.h"
#include "app/results/planner/plan_search.h"
#include "app/results/planner/write_plan.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/progress.h"
#include "app/system/read_file.h"

namespace abcal {
namespace {

/// Times of the table and the picture, in minutes.
constexpr std::array<double, 10> kCurveMinutes{2, 3, 4, 5, 7, 10, 15, 20, 30, 60};

double seconds_of(const std::string& text) {
  const std::map<std::string, double> kUnits{{"s", 1.0}, {"min", 60.0}, {"h", 3600.0}};
  double value = 0.0;
  std::string input = text;
  if (const std::string why = CLI::AsNumberWithUnit(kUnits, CLI::AsNumberWithUnit::UNIT_REQUIRED)(input);
      !why.empty())
    throw std::invalid_argument(
        fmt::format("--time {}: required: a time with its unit, such as 10min or 90s", text));
  std::from_chars(input.data(), input.data() + input.size(), value);
  if (!(value > 0.0) || value > 1e6)
    throw std::invalid_argument(fmt::format("--time {}: required: a time above 0 and below 1e6 s", text));
  return value;
}

KnownItem item_of(const ReachOptions& options, const BenchConfig& config) {
  if (!options.noise.empty()) {
    double value = 0.0;
    const char* const end = options.noise.data() + options.noise.size();
    const auto [stopped, error] = std::from_chars(options.noise.data(), end, value);
    if (error != std::errc() || stopped != end) {
      try {
        return item_of_run(options.noise);
      } catch (const std::invalid_argument& problem) {
        throw std::invalid_argument(fmt::format("--noise {}", problem.what()));
      }
    }
    if (!(value > 0.0) || value > 1.0)
      throw std::invalid_argument(
          fmt::format("--noise {}: required: above 0 and at most 1 (g_loc)", options.noise));
    return {.noise = value};
  }
  if (const auto simulated = simulated_noise(config)) return {.noise = *simulated};
  throw std::invalid_argument(
      "the noise of a reading is not known; required: --noise RUN (an earlier run of such an item) or "
      "--noise VALUE (standard deviation of one reading in g_loc)");
}

std::string value_text(double value) {
  return fmt::format("{:.2g}", value);
}

void print_prediction(const PlanPrediction& plan, const WantedValues& wanted) {
  print_result("{:>8} {:>10} {:>10} {:<7}  {}\n", "", "predicted", "wanted", "", "most of its variance");
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    const auto output = static_cast<PlannedOutput>(group);
    print_result("{:>8} {:>10} {:>10} {:<7}  {} ({:.0f} %)\n", symbol_of(output), value_text(plan.u[group]),
                 wanted[group] ? value_text(*wanted[group]) : "-", unit_of(output), plan.limits[group].name,
                 100.0 * plan.limits[group].share);
  }
}

void print_plan(const PlanPrediction& plan, double rate_hz) {
  const PlanDuration& duration = plan.duration;
  const ProtocolConfig& protocol = plan.protocol;
  if (protocol.is_constant_rate())
    print_result("Constant rate: {} at {:.3g} deg/s, up and down in turn, in {} steps of {:g} deg\n",
                 circles_and_angles(protocol), fmt::join(protocol.rate_deg_per_s, ", "), protocol.steps,
                 protocol.step.deg());
  else
    print_result("{} angles of {:g} deg, {} readings at each ({:.3g} s)\n", circles_and_angles(protocol),
                 protocol.step.deg() * protocol.faces, protocol.dwell_readings,
                 readings_per_dwell(protocol, rate_hz) / rate_hz);
  print_result("About {}: moving {}, settling {}, reading {}\n", describe_duration(duration.total_s()),
               describe_duration(duration.moving_s), describe_duration(duration.settling_s),
               describe_duration(duration.dwelling_s));
}

nlohmann::ordered_json prediction_json(const PlanPrediction& plan, const WantedValues& wanted) {
  nlohmann::ordered_json outputs = nlohmann::ordered_json::object();
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    const auto output = static_cast<PlannedOutput>(group);
    outputs[std::string(symbol_of(output))] = {
        {"standard_uncertainty", plan.u[group]},
        {"wanted", wanted[group] ? nlohmann::ordered_json(*wanted[group]) : nlohmann::ordered_json()},
        {"unit", unit_of(output)},
        {"largest_part", plan.limits[group].name},
        {"share", plan.limits[group].share}};
  }
  const ProtocolConfig& protocol = plan.protocol;
  nlohmann::ordered_json json{{"motion", protocol.motion}};
  if (protocol.is_constant_rate()) {
    json["rate_deg_per_s"] = protocol.rate_deg_per_s;
    json["sweeps"] = protocol.sweeps;
  }
  json.update({{"steps", protocol.steps},
               {"faces", protocol.faces},
               {"step_deg", protocol.step.deg()},
               {"dwell_readings", protocol.dwell_readings},
               {"estimator", protocol.estimator},
               {"moving_s", plan.duration.moving_s},
               {"settling_s", plan.duration.settling_s},
               {"dwelling_s", plan.duration.dwelling_s},
               {"outputs", outputs}});
  return json;
}

/// The wanted uncertainties, and the bench with its noise.
struct PlanQuestion {
  WantedValues wanted;
  std::optional<double> within_s;  ///< Absent: the shortest plan is requested.
  PlanningBench bench;
};

PlanQuestion question_of(const ReachOptions& options, PlanningBench bench) {
  PlanQuestion question{
      options.reach.empty() ? published_wanted() : parse_wanted(options.reach), {}, std::move(bench)};
  if (!options.time.empty()) question.within_s = seconds_of(options.time);
  if (!options.estimator.empty()) question.bench.config.protocol.estimator = options.estimator;
  question.bench.item = item_of(options, question.bench.config);
  return question;
}

FoundPlan answer_to(const PlanQuestion& question, const ReachOptions& options, PlanSearch& search) {
  if (!question.within_s) return search.shortest(question.wanted);
  FoundPlan found;
  found.plan = search.best_within(*question.within_s, question.wanted);
  if (found.plan) {
    found.readings_checked = found.plan->protocol.dwell_readings;
  } else {
    found.out_of_reach.push_back(
        fmt::format("--time {}: moves and settling alone last longer", options.time));
  }
  return found;
}

/// "Checked by the whole analysis of 3 simulated runs", and how much longer the plan became for it.
std::string check_words(const FoundPlan& found) {
  const int readings = found.plan->protocol.dwell_readings;
  std::string words = fmt::format("Checked by the whole analysis of {} simulated runs", kCheckedRuns);
  if (found.readings_checked < readings)
    words += fmt::format(
        ": it states up to {:.1f} % more than the search, which takes the noise as white; {} readings "
        "became {} for it",
        100.0 * (std::ranges::max(found.excess) - 1.0), found.readings_checked, readings);
  return words;
}

/// The best plan for each of kCurveMinutes that is long enough.
std::vector<PlanPrediction> curve(PlanSearch& search, const WantedValues& wanted) {
  std::vector<PlanPrediction> plans;
  for (const double minutes : kCurveMinutes)
    if (auto plan = search.best_within(60.0 * minutes, wanted)) plans.push_back(*std::move(plan));
  return plans;
}

void print_curve(const std::vector<PlanPrediction>& plans) {
  print_result(
      "\nWhat other times give (the best plan of each):\n{:>9} {:>9} {:>9} {:>10} {:>10} {:>10} {:>10}\n",
      "time/min", "angles", "readings", "s", "off", "O", "phi/deg");
  for (const PlanPrediction& plan : plans) {
    print_result("{:>9.1f} {:>9} {:>9} {:>10} {:>10} {:>10} {:>10}\n", plan.duration.total_s() / 60.0,
                 circles_and_angles(plan.protocol), plan.protocol.dwell_readings, value_text(plan.u[0]),
                 value_text(plan.u[1]), value_text(plan.u[2]), value_text(plan.u[3]));
  }
}

void plot_curve(const std::string& path, const std::vector<PlanPrediction>& plans) {
  std::string script =
      "set logscale xy\nset xlabel 'duration / min'\nset ylabel 'standard uncertainty (s, off, O: 1; phi: "
      "degree)'\n"
      "set grid\nset key outside right\n$plans << EOD\n";
  for (const PlanPrediction& plan : plans) {
    script += fmt::format("{} {} {} {} {}\n", plan.duration.total_s() / 60.0, plan.u[0], plan.u[1], plan.u[2],
                          plan.u[3]);
  }
  script += "EOD\nplot ";
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    script += fmt::format("{}$plans using 1:{} with linespoints dashtype {} title {}", group == 0 ? "" : ", ",
                          group + 2, group + 1,
                          gnuplot_quoted(std::string(symbol_of(static_cast<PlannedOutput>(group)))));
  }
  OutputFile(path).write(draw_svg(script + "\n", 400));
}

/// The plans that were tried, apart from what is said of a record of the stage.
std::string tried_words(const PlanSearch& search) {
  std::string words = "steps in one face";
  if (search.tried_two_faces()) words += ", steps in two faces";
  if (search.tried_sweeps()) words += ", turning at a constant rate";
  return words;
}

void print_answer(const PlanQuestion& question, const FoundPlan& found, const PlanSearch& search) {
  const BenchConfig& config = question.bench.config;
  for (const std::string& words : found.out_of_reach) print_result("Out of reach: {}\n", words);
  if (found.plan) {
    print_plan(*found.plan, config.items.front().accelerometer.settings.rate_hz);
    print_prediction(*found.plan, question.wanted);
    print_result("{}.\n", check_words(found));
  }
  if (!std::ranges::all_of(question.bench.speed, [](const AxisSpeed& axis) { return axis.deg_per_s > 0.0; }))
    print_result(
        "The speed of an axis is not stated ([stage.x] and [stage.z] speed_deg_per_s): its moves are not "
        "counted, and no constant rate is tried.\n");
  if (config.has_several_items())
    print_result("Predicted for item 1 alone of {}: another with more noise, or at a lower rate, has more.\n",
                 config.items.size());
  print_result("Tried: {}{}.\n", tried_words(search),
               question.bench.stage_record.record ? "; with the record of the stage" : "");
  print_result("Noise of one reading: {:.3g} g_loc, taken as white. The item {}. Estimator: {}.\n",
               question.bench.item.noise,
               question.bench.item.sensitivity_matrix == usual_directions()
                   ? "is taken to stand as usual, 0.3 to 0.6 degrees askew; --noise RUN, an earlier run, "
                     "would tell more"
                   : "is as the earlier run found it",
               config.protocol.estimator);
}

nlohmann::ordered_json answer_json(const PlanQuestion& question, const FoundPlan& found,
                                   const std::vector<PlanPrediction>& others) {
  nlohmann::ordered_json json{{"schema", "abcal.plan/1"},
                              {"noise", question.bench.item.noise},
                              {"predicted", nullptr},
                              {"out_of_reach", found.out_of_reach},
                              {"curve", nlohmann::ordered_json::array()}};
  if (found.plan) {
    json["predicted"] = prediction_json(*found.plan, question.wanted);
    json["checked"] = {{"runs", kCheckedRuns}, {"dwell_readings", found.readings_checked}};
  }
  for (const PlanPrediction& plan : others) json["curve"].push_back(prediction_json(plan, question.wanted));
  return json;
}

void write_into_bench_file(const ReachOptions& options, const PlanPrediction& plan) {
  OutputFile(options.bench_file)
      .write(with_protocol(read_file(options.bench_file), plan.protocol, options.bench_file,
                           register_records()));
  print_log("{} has the plan now\n", options.bench_file);
}

}  // namespace

void add_question_options(CLI::App& command, ReachOptions& options) {
  command.add_option(
      "--reach", options.reach,
      "find the shortest plan with these standard uncertainties: 's=2e-5, off=2e-4, O=5e-5, phi=1e-3 deg'");
  command.add_option("--time", options.time, "find the best plan that lasts at most so long: 10min, 90s");
  command.add_option(
      "--noise", options.noise,
      "noise of one reading: standard deviation in g_loc, or an earlier run of the item, which tells its "
      "angles and offsets as well (default: that of [simulation], where the accelerometer is simulated)");
}

void add_reach_options(CLI::App& command, ReachOptions& options) {
  add_question_options(command, options);
  command.add_option("--estimator", options.estimator, "instead of the one in the bench file")
      ->check(CLI::IsMember({"abc", "joint"}));
  command.add_flag("--others", options.others, "print too what other times give");
  command.add_option("--plot", options.plot, "SVG to write: uncertainties against time");
  command.add_flag("--write", options.write, "put the plan that was found into the bench file");
}

std::string question_words(const ReachOptions& options) {
  std::string words;
  const auto add = [&](std::string_view name, const std::string& value) {
    if (!value.empty()) words += fmt::format("{}{} {}", words.empty() ? "" : ", ", name, value);
  };
  add("reach", options.reach);
  add("time", options.time);
  add("noise", options.noise);
  return words;
}

PlanPrediction find_plan(const ReachOptions& options, const BenchConfig& config) {
  const PlanQuestion question = question_of(options, planning_bench(config, {}));
  PlanSearch search(question.bench);
  FoundPlan found = answer_to(question, options, search);
  if (!found.plan)
    throw std::runtime_error(fmt::format("out of reach: {}", fmt::join(found.out_of_reach, "; ")));
  return *std::move(found.plan);
}

int run_reach(const ReachOptions& options, PlanningBench bench) {
  const PlanQuestion question = question_of(options, std::move(bench));
  const WantedValues& wanted = question.wanted;
  if (!options.plot.empty()) require_writable({{"--plot", options.plot}}, {options.bench_file}, true);
  PlanSearch search(question.bench);
  const FoundPlan found = answer_to(question, options, search);
  if (options.write && found.plan) write_into_bench_file(options, *found.plan);
  if (!options.json) print_answer(question, found, search);
  std::vector<PlanPrediction> others;
  if (options.others || !options.plot.empty()) others = curve(search, wanted);
  if (!options.plot.empty()) plot_curve(options.plot, others);
  if (options.json) {
    print_result("{}\n", answer_json(question, found, others).dump(2));
  } else if (options.others) {
    print_curve(others);
  }
  return found.plan ? kExitDone : kExitFailed;
}

}  // namespace abcal
