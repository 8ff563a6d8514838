#include <fmt/format.h>

#include <map>
#include <nlohmann/json.hpp>

#include "app/commands/commands.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "protocol/gravity/local_gravity.h"

namespace abcal {
namespace {

constexpr double kCoverageFactor = 2.0;  // as for latitude_deg and height_m in a bench file

/// The lines for a bench file, with the digits of the formulas.
std::string bench_piece(const FormulaGravity& gravity) {
  return fmt::format(
      "[bench]\n"
      "g_loc_mps2 = {:.10f}\n"
      "g_loc_expanded_uncertainty_mps2 = {:.7f}\n"
      "g_loc_k = {:.1f}\n"
      "g_loc_source = \"{}\"\n",
      gravity.value_mps2, kCoverageFactor * gravity.standard_uncertainty_mps2, kCoverageFactor,
      gravity.source);
}

nlohmann::ordered_json gravity_json(const FormulaGravity& gravity, GravityFormula formula,
                                    double latitude_deg, double height_m) {
  return {{"schema", "abcal.gravity/1"},
          {"formula", to_string(formula)},
          {"latitude_deg", latitude_deg},
          {"height_m", height_m},
          {"g_loc",
           {{"value", gravity.value_mps2},
            {"standard_uncertainty", gravity.standard_uncertainty_mps2},
            {"expanded_uncertainty", kCoverageFactor * gravity.standard_uncertainty_mps2},
            {"coverage_factor", kCoverageFactor},
            {"distribution", "rectangular"},
            {"half_width", gravity.half_width_mps2},
            {"unit", "m/s2"},
            {"source", gravity.source}}},
          {"warning", gravity.warning},
          {"bench", bench_piece(gravity)}};
}

}  // namespace

CLI::App* add_gravity(CLI::App& parent, int& exit_code) {
  struct Options {
    double latitude_deg = 0.0;
    double height_m = 0.0;
    std::string formula = "grs80";
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "gravity", "Local gravity by formula, with its uncertainty, for a site without a survey");
  command->add_option("--latitude", options->latitude_deg, "geodetic latitude in degrees, south negative")
      ->required();
  command->add_option("--height", options->height_m, "height above sea level in metres")->required();
  static const std::map<std::string, GravityFormula> formulas{{"grs80", GravityFormula::kGrs80},
                                                              {"wgs84", GravityFormula::kWgs84},
                                                              {"welmec", GravityFormula::kWelmec},
                                                              {"npl", GravityFormula::kNpl}};
  command->add_option("--formula", options->formula, "grs80, wgs84, welmec or npl (default: grs80)")
      ->check(CLI::IsMember(&formulas, CLI::ignore_case))
      ->option_text("NAME");
  command->add_flag("--json", options->json, "print one JSON object, schema abcal.gravity/1");
  command->callback([options, &exit_code] {
    const GravityFormula formula = formulas.at(CLI::detail::to_lower(options->formula));
    const FormulaGravity gravity =
        formula_gravity(Angle::degrees(options->latitude_deg), options->height_m, formula);
    if (options->json) {
      print_result("{}\n", gravity_json(gravity, formula, options->latitude_deg, options->height_m).dump(2));
    } else {
      print_result("g_loc  {:.10f} m/s2  ({})\n", gravity.value_mps2, gravity.source);
      print_result(
          "u      {:.7f} m/s2  (standard; rectangular, half width {:.7f} m/s2 = 5e-5 of the value)\n",
          gravity.standard_uncertainty_mps2, gravity.half_width_mps2);
      print_result("\nFor the bench file:\n\n{}", bench_piece(gravity));
      print_warning(gravity.warning);
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
