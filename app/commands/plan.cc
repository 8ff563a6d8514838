#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/bench/bench_config.h"
#include "app/bench/key_reference.h"
#include "app/commands/commands.h"
#include "app/results/effect_words.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {
namespace {

/// What is known of an axis without asking the stage.
struct KnownAxis {
  AxisTravel travel;
  double speed_deg_per_s = 0.0;
  bool travel_assumed = false;
};

KnownAxis known_axis(const StageConfig& stage, const StageAxisConfig& axis, const sim::AxisTruth& truth) {
  KnownAxis known;
  const bool simulated = stage.port == "simulated";
  if (simulated) {
    known.travel = {truth.travel_min, truth.travel_max};
    known.speed_deg_per_s = truth.speed_deg_per_s;
  }
  if (axis.travel_min_deg)
    known.travel.min = std::max(known.travel.min, Angle::degrees(*axis.travel_min_deg));
  if (axis.travel_max_deg)
    known.travel.max = std::min(known.travel.max, Angle::degrees(*axis.travel_max_deg));
  if (axis.speed_deg_per_s) known.speed_deg_per_s = *axis.speed_deg_per_s;
  known.travel_assumed = !simulated && !(axis.travel_min_deg && axis.travel_max_deg);
  return known;
}

}  // namespace

CLI::App* add_plan(CLI::App& parent, int& exit_code) {
  struct Options {
    std::string bench_file;
    bool json = false;
    bool keys = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("plan", "Show the sequence, its duration, and every problem of the bench file");
  CLI::Option* bench = command->add_option("BENCH", options->bench_file, "bench file (TOML)");
  command->add_flag("--json", options->json, "print one JSON object");
  command->add_flag("--keys", options->keys, "print the reference of all keys of a bench file (Markdown)")
      ->excludes(bench);
  command->callback([options, &exit_code] {
    if (options->keys) {
      print_result("{}", bench_file_page());
      exit_code = kExitDone;
      return;
    }
    if (options->bench_file.empty()) throw CLI::RequiredError("BENCH");
    const BenchConfig config = read_bench(options->bench_file);
    for (const std::string& warning : config.warnings) print_warning(warning);
    const KnownAxis x = known_axis(config.stage, config.stage.x, config.simulation.x);
    const KnownAxis z = known_axis(config.stage, config.stage.z, config.simulation.z);
    const std::vector<PlannedAngle> plan = make_rotation_plan(config.protocol, {x.travel, z.travel});
    const PlanDuration duration = estimate_duration(
        plan, config.protocol, {x.speed_deg_per_s, z.speed_deg_per_s}, config.accelerometer.rate_hz);
    const std::array<AxisTravel, 2> twist = cable_twist(plan, config.protocol);
    if (options->json) {
      nlohmann::ordered_json json{{"schema", "abcal.plan/1"},
                                  {"angles", nlohmann::ordered_json::array()},
                                  {"moving_s", duration.moving_s},
                                  {"settling_s", duration.settling_s},
                                  {"dwelling_s", duration.dwelling_s},
                                  {"travel_assumed", x.travel_assumed || z.travel_assumed},
                                  {"estimator", config.protocol.estimator},
                                  {"default_effects", unstated_effects(config.tolerances)},
                                  {"cable_twist_deg",
                                   {{"x", {twist[0].min.deg(), twist[0].max.deg()}},
                                    {"z", {twist[1].min.deg(), twist[1].max.deg()}}}}};
      for (const PlannedAngle& angle : plan) {
        json["angles"].push_back({{"experiment", angle.experiment},
                                  {"n", angle.n},
                                  {"closing", angle.closing},
                                  {"alpha_deg", angle.alpha.deg()},
                                  {"x_deg", angle.x.deg()},
                                  {"z_deg", angle.z.deg()},
                                  {"check", angle.check}});
      }
      print_result("{}\n", json.dump(2));
    } else {
      print_result("{:>5} {:>10} {:>5} {:>10} {:>10} {:>10}\n", "", "experiment", "n", "alpha/deg", "X/deg",
                   "Z/deg");
      for (std::size_t k = 0; k < plan.size(); ++k) {
        const PlannedAngle& angle = plan[k];
        print_result("{:>5} {:>10} {:>5} {:>10g} {:>10g} {:>10g}{}\n", k + 1, angle.experiment, angle.n,
                     angle.alpha.deg(), angle.x.deg(), angle.z.deg(),
                     angle.closing ? "  closing angle"
                     : angle.check ? "  check pose"
                                   : "");
      }
      print_result("{} angles; {} readings at each\n", plan.size(),
                   readings_per_dwell(config.protocol, config.accelerometer.rate_hz));
      if (x.speed_deg_per_s > 0.0 && z.speed_deg_per_s > 0.0) {
        print_result("About {}: moving {}, settling {}, reading {}\n", describe_duration(duration.total_s()),
                     describe_duration(duration.moving_s), describe_duration(duration.settling_s),
                     describe_duration(duration.dwelling_s));
      } else {
        print_result(
            "About {} and the moves (the bench file gives no speed_deg_per_s): settling {}, reading {}\n",
            describe_duration(duration.total_s()), describe_duration(duration.settling_s),
            describe_duration(duration.dwelling_s));
      }
      print_result(
          "Cables are wound from {:g} to {:g} deg about X and from {:g} to {:g} deg about Z, counted from "
          "zero; "
          "the stage is parked at zero. Where they do not reach so far, say travel_min_deg and "
          "travel_max_deg.\n",
          twist[0].min.deg(), twist[0].max.deg(), twist[1].min.deg(), twist[1].max.deg());
      print_result("The result will be that of the {} estimator.\n", config.protocol.estimator);
      if (const std::string words = default_effects_words(config.tolerances); !words.empty())
        print_result("Note: {}.\n", words);
      if (x.travel_assumed || z.travel_assumed) {
        print_result(
            "The travel of the stage was taken as -360 to 360 deg where the bench file does not say; `run` "
            "asks "
            "the stage.\n");
      }
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
