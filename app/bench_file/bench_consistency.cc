#include "app/bench_file/bench_consistency.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/bench_keys.h"
#include "app/bench_file/chamber_consistency.h"
#include "app/bench_file/instrument_ports.h"
#include "app/bench_file/key_ranges.h"
#include "app/bench_file/stage_description_file.h"
#include "drivers/instrument/driver_catalogue.h"
#include "drivers/text/text.h"
#include "protocol/gravity/local_gravity.h"
#include "protocol/plan/faces.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {
namespace {

constexpr const char* kPortWords = "a port: a path, usb:VID:PID[:SERIAL], tcp:HOST:PORT, or \"simulated\"";

DriverTraits traits_of_stage(const std::string& driver) {
  return find_in(driver_catalogue().stages, driver).traits;
}

bool makes_daisy_chains(const std::string& driver) {
  return traits_of_stage(driver).last_chain_address > 0;
}

/// "the driver pi_gcs or zaber_ascii"
std::string a_driver_of_chains() {
  std::vector<std::string> names;
  for (const CataloguedDriver& driver : driver_catalogue().stages)
    if (driver.traits.last_chain_address > 0) names.push_back(driver.name);
  return fmt::format("the driver {}", fmt::join(names, " or "));
}

/// @param where  path of the section
void check_address(TomlReader& reader, const std::string& where, const std::string& driver,
                   const std::string& address) {
  if (address.empty() || !makes_daisy_chains(driver)) return;
  const int last = traits_of_stage(driver).last_chain_address;
  for (int one = 1; one <= last; ++one)
    if (address == std::to_string(one)) return;
  reader.add_problem(where + ".address", "\"" + address + "\"", fmt::format("\"1\" to \"{}\"", last));
}

/// Two controllers on one port, distinguished by their addresses.
void check_addresses(TomlReader& reader, const StageConfig& stage, const std::string& driver) {
  if (traits_of_stage(driver).needs_chain_addresses && (stage.x.address.empty() || stage.z.address.empty()))
    reader.add_problem("stage.z.address", "no address of one or both of the controllers on one port",
                       "address under [stage.x] and [stage.z]");
  if (stage.x.address == stage.z.address && stage.x.axis == stage.z.axis)
    reader.add_problem("stage.z.axis", "\"" + stage.z.axis + "\", the same as [stage.x] axis",
                       "two different axes");
}

/// Two controllers on one port: of one maker, in a daisy chain.
void check_chain(TomlReader& reader, const StageConfig& stage) {
  if (stage.x.driver != stage.z.driver || !makes_daisy_chains(stage.x.driver)) {
    reader.add_problem("stage.z.port", "\"" + stage.z.port + "\", the port of [stage.x]",
                       "another port; or " + a_driver_of_chains() + " for both, in a daisy chain");
    return;
  }
  if (stage.x.baud != stage.z.baud)
    reader.add_problem("stage.z.baud", "another one than that of [stage.x]",
                       "the same, as both are on one port");
  check_addresses(reader, stage, stage.x.driver);
}

/// [stage] has driver and port, and each axis the address of its controller.
void check_short_chain(TomlReader& reader, const StageConfig& stage) {
  if (!makes_daisy_chains(stage.driver))
    reader.add_problem("stage.driver",
                       "\"" + stage.driver + "\", with an address under [stage.x] or [stage.z]",
                       a_driver_of_chains() + ", for controllers in a daisy chain");
  if (!stage.address.empty())
    reader.add_problem("stage.address", "\"" + stage.address + "\", beside the addresses of the axes",
                       "an address under [stage], or under [stage.x] and [stage.z]");
  check_addresses(reader, stage, stage.driver);
}

/// One controller for both axes, or one for each; a driver that exchanges bytes has a port.
void check_stage_ports(TomlReader& reader, StageConfig& stage) {
  if (!stage.split()) {
    if (stage.driver.empty())
      reader.add_problem("stage.driver", "nothing", "one of " + joined(stage_driver_names()));
    const bool no_bytes =
        stage.driver == "simulated" || !find_in(driver_catalogue().stages, stage.driver).has_port;
    if (no_bytes && stage.port.empty()) stage.port = stage.driver;
    if (no_bytes && stage.port != stage.driver)
      reader.add_problem("stage.port", "\"" + stage.port + "\"",
                         "\"" + stage.driver + "\", as the driver is");
    if (stage.port.empty()) reader.add_problem("stage.port", "nothing", kPortWords);
    for (const auto& [section, axis] : {std::pair{"stage.x", &stage.x}, std::pair{"stage.z", &stage.z}}) {
      if (!axis->port.empty())
        reader.add_problem(std::string(section) + ".port", "\"" + axis->port + "\"",
                           "driver and port for both axes, or for neither");
      check_address(reader, section, stage.driver, axis->address);
    }
    check_address(reader, "stage", stage.driver, stage.address);
    if (stage.addressed()) check_short_chain(reader, stage);
    return;
  }
  for (const auto& [key, value] : {std::pair{"driver", stage.driver}, std::pair{"port", stage.port}}) {
    if (!value.empty())
      reader.add_problem(std::string("stage.") + key, "\"" + value + "\"",
                         "nothing, as [stage.x] and [stage.z] have their own");
  }
  for (const auto& [section, axis] : {std::pair{"stage.x", &stage.x}, std::pair{"stage.z", &stage.z}}) {
    if (axis->driver.empty())
      reader.add_problem(std::string(section) + ".driver", "nothing", "a driver, as the other axis has one");
    if (axis->port.empty()) reader.add_problem(std::string(section) + ".port", "nothing", kPortWords);
    check_address(reader, section, axis->driver, axis->address);
  }
  if (!stage.x.port.empty() && stage.chained()) check_chain(reader, stage);
}

/// One port has one instrument; names of serial ports of another system are none here.
void check_ports(TomlReader& reader, const BenchConfig& c, bool is_list) {
  std::map<std::string, std::string> owners;
  const auto check = [&](const std::string& where, const std::string& port) {
    const std::string found = "\"" + port + "\"";
    const std::string name = pieces::lower(port);
    if (name.size() > 3 && name.starts_with("com") &&
        name.find_first_not_of("0123456789", 3) == std::string::npos)
      reader.add_problem(where, found,
                         "a port of this computer, such as \"/dev/ttyUSB0\": `abcal instruments` lists them");
    const auto owner = owners.emplace(port, where).first;
    // Port 0 is any free one, which an emulator takes.
    const bool is_real = (port.starts_with("usb:") || has_tcp_frames(port) || port.starts_with("/dev/")) &&
                         !port.ends_with(":0");
    if (is_real && owner->second != where)
      reader.add_problem(where, fmt::format("{}, which {} has", found, owner->second),
                         "another port: one port has one instrument");
  };
  const auto key_of_stage = [&](const InstrumentPort& port) {
    if (!c.stage.split()) return "stage.port";
    return port.axis == StageAxis::kZ ? "stage.z.port" : "stage.x.port";
  };
  for (const InstrumentPort& port : stage_ports(c.stage)) check(key_of_stage(port), port.port);
  for (const InstrumentPort& port : all_accelerometer_ports(c))
    check(is_list ? "item" : "accelerometer.port", port.port);
  for (const InstrumentPort& port : environment_ports(c.environment)) check("environment.port", port.port);
}

void check_gravity(TomlReader& reader, const toml::table& root, BenchConfig& c) {
  if (root.at_path("bench.g_loc_mps2").is_table()) {
    for (const char* key : {"g_loc_expanded_uncertainty_mps2", "g_loc_k", "g_loc_source"})
      if (root["bench"].as_table()->contains(key))
        reader.add_problem(std::string("bench.") + key, "a value beside the record of g_loc_mps2",
                           "nothing: the record gives it");
  }
  const bool value_given = root.at_path("bench.g_loc_mps2").node() != nullptr;
  if (!value_given && !(c.latitude_deg && c.height_m)) {
    reader.add_problem("bench.g_loc_mps2", "neither g_loc_mps2 nor latitude_deg and height_m",
                       "local gravity in m/s2 (a survey is best), or latitude and height for a formula");
  } else if (!value_given && std::isfinite(*c.latitude_deg) && std::isfinite(*c.height_m)) {
    const FormulaGravity formula = formula_gravity(Angle::degrees(*c.latitude_deg), *c.height_m);
    c.g_loc = {formula.value_mps2, 2.0 * formula.standard_uncertainty_mps2, 2.0, formula.source};
    c.warnings.push_back(formula.warning);
  } else if (root.at_path("bench.g_loc_expanded_uncertainty_mps2").value<double>() == 0.0 &&
             !c.g_loc.source.empty() && c.stage.driver != kSimulated) {
    c.warnings.emplace_back(
        "g_loc_expanded_uncertainty_mps2 is 0: no gravity is known exactly, and U of the sensitivities is "
        "too small "
        "without its part");
  }
}

bool is_range(double min, double max) {
  return !std::isfinite(min) || !std::isfinite(max) || min < max;  // Others are reported already.
}

std::string travel_words(double min, double max) {
  return fmt::format("{:g} to {:g}", min, max);
}

/// Checks the travel that [stage.x] states; an end that it does not state is that of the simulation.
/// @param where      path of the section
/// @param simulated  path of the simulation's section; empty: not compared with it
void check_stated_travel(TomlReader& reader, const std::string& where, const StageAxisConfig& axis,
                         const std::string& simulated, const sim::AxisTruth& truth) {
  const auto &min = axis.travel_min_deg, &max = axis.travel_max_deg;
  const double lowest = truth.travel_min.deg(), highest = truth.travel_max.deg();
  if (min && max && !is_range(*min, *max)) {
    reader.add_problem(where + ".travel_min_deg", travel_words(*min, *max),
                       "travel_min_deg < travel_max_deg");
    return;
  }
  if (simulated.empty()) return;
  const std::string other = fmt::format("the travel of [{}] is {}", simulated, travel_words(lowest, highest));
  if (min && !is_range(*min, highest))
    reader.add_problem(where + ".travel_min_deg", fmt::format("{:g}", *min),
                       fmt::format("below {:g}, as {}", highest, other));
  if (max && !is_range(lowest, *max))
    reader.add_problem(where + ".travel_max_deg", fmt::format("{:g}", *max),
                       fmt::format("above {:g}, as {}", lowest, other));
}

void check_travel(TomlReader& reader, const toml::table& root, const BenchConfig& c,
                  const std::string& name) {
  const StageAxisConfig& axis = name == "x" ? c.stage.x : c.stage.z;
  const sim::AxisTruth& truth = name == "x" ? c.simulation.x : c.simulation.z;
  const std::string simulation = "simulation." + name;
  const bool is_good = is_range(truth.travel_min.deg(), truth.travel_max.deg());
  if (!is_good) {
    const bool has_min = root.at_path(simulation + ".travel_min_deg").node() != nullptr;
    reader.add_problem(simulation + (has_min ? ".travel_min_deg" : ".travel_max_deg"),
                       travel_words(truth.travel_min.deg(), truth.travel_max.deg()),
                       "travel_min_deg < travel_max_deg");
  }
  const std::string& port = c.stage.split() ? axis.port : c.stage.port;
  const bool simulated = port == "simulated" || c.stage.driver == "simulated";
  check_stated_travel(reader, "stage." + name, axis, is_good && simulated ? simulation : "", truth);
}

/// Reads the description of a described stage; its text is kept.
void check_description(TomlReader& reader, StageConfig& stage) {
  if (!stage.is_described()) {
    for (const auto& [key, axis] :
         {std::pair{"stage.x.units_per_degree", &stage.x}, std::pair{"stage.z.units_per_degree", &stage.z}})
      if (axis->units_per_degree)
        reader.add_problem(key, fmt::format("{:g} with another driver", *axis->units_per_degree),
                           "driver = \"described\", or no units_per_degree");
    for (const auto& [key, value] : {std::pair{"stage.description", &stage.description},
                                     std::pair{"stage.description_text", &stage.description_text}})
      if (!value->empty())
        reader.add_problem(key, "a description with another driver",
                           "driver = \"described\", or no description");
    return;
  }
  if (stage.description.empty() && stage.description_text.empty()) {
    reader.add_problem("stage.description", "nothing",
                       "the name of a description that is shipped, or the path of a file");
    return;
  }
  std::vector<Problem> problems;
  if (stage.description_text.empty())
    stage.description_text = stage_description_text(stage.description, problems);
  StageDescription description;
  if (problems.empty())
    description = parse_stage_description(stage.description_text, stage.description, problems);
  if (!problems.empty()) {
    reader.add_problem("stage.description",
                       "\"" + stage.description + "\", with problems:" + list_of(problems),
                       "a description without problems: `abcal stage try FILE` shows them");
    return;
  }
  for (const auto& [section, axis] : {std::pair{"stage.x", &stage.x}, std::pair{"stage.z", &stage.z}}) {
    if (stage.driver != kDescribed && axis->driver != kDescribed) continue;
    const auto& names = description.axis_names;
    if (!names.empty() && std::ranges::find(names, axis->axis) == names.end())
      reader.add_problem(std::string(section) + ".axis", "\"" + axis->axis + "\"",
                         "one of " + joined(names) + ", as the description names them");
    if (axis->speed_deg_per_s && !description.sets_speed())
      reader.add_problem(std::string(section) + ".speed_deg_per_s",
                         fmt::format("{:g}", *axis->speed_deg_per_s),
                         "none: the description has no [[set_speed]]");
    if (axis->units_per_degree && !description.scale_in_bench)
      reader.add_problem(std::string(section) + ".units_per_degree",
                         fmt::format("{:g}", *axis->units_per_degree), "none: the description has the scale");
    if (!axis->units_per_degree && description.scale_in_bench)
      reader.add_problem(
          std::string(section) + ".units_per_degree", "nothing",
          "the units of the controller in a degree of this axis: the description leaves them to "
          "the bench file, as they depend on motor, gear and steps");
    if (description.wraps && !axis->wraps_deg) axis->wraps_deg = 360.0;
  }
}

void check_stage_axes(TomlReader& reader, const toml::table& root, BenchConfig& c) {
  StageConfig& stage = c.stage;
  check_description(reader, stage);
  for (const char* name : {"x", "z"}) check_travel(reader, root, c, name);
  for (const auto& [section, axis] :
       {std::pair{"stage.x.sign", &stage.x}, std::pair{"stage.z.sign", &stage.z}}) {
    if (axis->sign == 0) reader.add_problem(section, "0", "1 or -1");
  }
  for (const auto& [section, axis] : {std::pair{"stage.x", &stage.x}, std::pair{"stage.z", &stage.z}}) {
    if (axis->wraps_deg && !(axis->travel_min_deg && axis->travel_max_deg))
      reader.add_problem(
          std::string(section) + ".wraps_deg", fmt::format("{:g}", *axis->wraps_deg),
          "travel_min_deg and travel_max_deg of this axis too: the controller's own count does "
          "not limit how far the cable is wound");
  }
  if (!stage.split() && !stage.addressed() && stage.x.axis == stage.z.axis) {
    reader.add_problem("stage.z.axis", "\"" + stage.z.axis + "\", the same as [stage.x] axis",
                       "two different axes");
  }
}

/// Reports plans at a constant rate that cannot be measured, as far as the bench file shows this.
void check_constant_rate(TomlReader& reader, const BenchConfig& c) {
  const ProtocolConfig& p = c.protocol;
  if (c.turned_by_hand())
    reader.add_problem("protocol.motion", "\"constant_rate\" with driver \"" + c.stage.driver + "\"",
                       "a stage that turns at a stated rate, or \"steps\"");
  if (p.faces == kFaces)
    reader.add_problem("protocol.faces", "2 with motion = \"constant_rate\"", "faces = 1");
  if (!c.temperature.set_points_degc.empty())
    reader.add_problem("protocol.motion", "\"constant_rate\" with [temperature] set_points_degc",
                       "\"steps\"");
  if (p.estimator != kDefaultEstimator)
    reader.add_problem("protocol.estimator", "\"" + p.estimator + "\" with motion = \"constant_rate\"",
                       "\"joint\"");
  if (p.rate_deg_per_s.empty()) {
    reader.add_problem("protocol.rate_deg_per_s", "an empty list", "a rate at least, as [60, 20]");
    return;
  }
  if (p.stops > 0 && p.steps % p.stops != 0)
    reader.add_problem("protocol.stops", fmt::format("{} with {} steps", p.stops, p.steps),
                       "0, or a number that divides steps");
  const auto [slowest, fastest] = std::ranges::minmax(p.rate_deg_per_s);
  const bool one_rate = slowest == fastest || p.sweeps < 2;
  for (const BenchItemConfig& item : c.items) {
    if (one_rate && p.stops == 0 && !item.tolerances.sources.contains("low_pass")) {
      reader.add_problem(
          "protocol.rate_deg_per_s", fmt::format("one rate, {:g} deg/s, and no stops", fastest),
          "a second rate, stops, or a stated [item_uncertainty] low_pass: a loss of amplitude at this rate "
          "cannot be told from the sensitivity at rest");
      break;
    }
  }
  for (const BenchItemConfig& item : c.items) {
    const double readings = readings_of_step(p, fastest, item.accelerometer.settings.rate_hz);
    if (readings >= kLeastReadingsOfStep) continue;
    reader.add_problem(
        "protocol.rate_deg_per_s",
        fmt::format("{:g} deg/s, at which {:.2g} readings at {:g} Hz fall on a step of {:g} deg", fastest,
                    readings, item.accelerometer.settings.rate_hz, p.step.deg()),
        fmt::format("at least {:g} readings: a lower rate, larger steps (steps = {}, step_deg = "
                    "{:g}) or more readings a second",
                    kLeastReadingsOfStep, p.steps / 2, 2.0 * p.step.deg()));
    break;
  }
}

void check_plan_and_item(TomlReader& reader, const BenchConfig& c) {
  if (c.protocol.step.deg() * (c.protocol.steps - 1) >= 360.0) {
    reader.add_problem("protocol.steps",
                       fmt::format("{} steps of {} deg", c.protocol.steps, c.protocol.step.deg()),
                       "(steps - 1) * step_deg < 360");
  }
  constexpr int kLeastInTwoFaces = 8;
  if (c.protocol.faces == kFaces && (c.protocol.steps % kFaces != 0 || c.protocol.steps < kLeastInTwoFaces)) {
    reader.add_problem("protocol.steps", fmt::format("{} with faces = 2", c.protocol.steps),
                       fmt::format("an even number of at least {}: half of the angles belong to each face",
                                   kLeastInTwoFaces));
  }
  if (c.protocol.faces == kFaces && !c.allows_two_faces()) {
    reader.add_problem(
        "protocol.faces",
        c.has_several_items() ? "2 with several items" : "2 with [temperature] set_points_degc",
        "faces = 1: several items and series over temperature are measured in one face");
  }
  if (c.protocol.is_constant_rate()) check_constant_rate(reader, c);
  const LimitsConfig& limits = c.items.front().limits;
  if (!(limits.temperature_min_degc < limits.temperature_max_degc)) {
    reader.add_problem("limits.temperature_min_degc",
                       fmt::format("{} to {}", limits.temperature_min_degc, limits.temperature_max_degc),
                       "temperature_min_degc < temperature_max_degc");
  }
}

constexpr const char* kMountingWords =
    "the axes along which u, v and w point, each once, as \"x y z\" or \"-y x z\"; or nine numbers, the rows "
    "of a rotation matrix";

/// @param where  path of the section [accelerometer]
void check_accelerometer(TomlReader& reader, const std::string& where, AccelerometerConfig& accelerometer) {
  if (accelerometer.driver == "simulated") {
    if (accelerometer.port.empty()) accelerometer.port = "simulated";
    if (accelerometer.port != "simulated")
      reader.add_problem(where + ".port", "\"" + accelerometer.port + "\"",
                         "\"simulated\", as the driver is");
  } else if (accelerometer.port.empty()) {
    reader.add_problem(where + ".port", "nothing", kPortWords);
  }
  const bool names_a_device =
      find_in(driver_catalogue().accelerometers, accelerometer.driver).traits.names_device;
  if (const std::size_t names = pieces::words(accelerometer.settings.names).size();
      names != 0 && names != 3 && !names_a_device)
    reader.add_problem(where + ".names", "\"" + accelerometer.settings.names + "\"",
                       "the names of u, v and w, with blanks between");
  for (const double scale : accelerometer.settings.scale) {
    if (std::abs(scale) < kLeastResponse)
      reader.add_problem(where + ".scale", fmt::format("{:g}", scale),
                         fmt::format("no zeros: at least {:g} in size", kLeastResponse));
  }
}

void check_environment(TomlReader& reader, const EnvironmentConfig& environment) {
  if (environment.driver.empty() != environment.port.empty())
    reader.add_problem(environment.port.empty() ? "environment.port" : "environment.driver", "nothing",
                       "driver and port, or neither");
}

/// Compares the simulated sensitivity with the instrument's unit: an output in m/s2 is 9.8 for 1 g_loc.
/// @param where  path of the item's section and a point; empty: the top of the file
void check_simulated_unit(TomlReader& reader, const std::string& where, const BenchItemConfig& item) {
  if (item.accelerometer.port != "simulated") return;
  if (const auto problem = simulated_unit_problem(item))
    reader.add_problem(where + problem->where, problem->found, problem->required);
}

/// Reports a value that a second item has as well.
class OnlyOnce {
 public:
  OnlyOnce(TomlReader& reader, std::string required) : reader_(reader), required_(std::move(required)) {}
  /// @param shown  the part of `value` that the file has at `where`
  void look(const std::string& value, const std::string& shown, std::size_t item, const std::string& where) {
    const auto [first, is_new] = first_.emplace(value, item);
    if (!is_new)
      reader_.add_problem(where, fmt::format("\"{}\", as item {} has", shown, first->second + 1), required_);
  }

 private:
  TomlReader& reader_;
  std::string required_;
  std::map<std::string, std::size_t> first_;
};

/// Each item has its own port. TCP port 0 may be repeated: it stands for any free port.
void check_ports_of_items(TomlReader& reader, const std::vector<BenchItemConfig>& items) {
  OnlyOnce ports(reader, "a port of its own for each item");
  for (std::size_t i = 0; i < items.size(); ++i) {
    for (const std::string_view port : pieces::words(items[i].accelerometer.port)) {
      if (port == "simulated" || port.ends_with(":0")) continue;
      ports.look(std::string(port), std::string(port), i, fmt::format("item[{}].accelerometer.port", i));
    }
  }
}

void check_names_of_items(TomlReader& reader, const std::vector<BenchItemConfig>& items) {
  OnlyOnce names(reader, "each item once");
  OnlyOnce instruments(reader, "each instrument once");
  for (std::size_t i = 0; i < items.size(); ++i) {
    const ItemConfig& item = items[i].item;
    const AccelerometerConfig& accelerometer = items[i].accelerometer;
    if (!item.serial_number.empty())
      names.look(fmt::format("{} {} {}", item.maker, item.model, item.serial_number), item.serial_number, i,
                 fmt::format("item[{}].serial_number", i));
    if (!accelerometer.serial_number.empty())
      instruments.look(fmt::format("{} {}", accelerometer.driver, accelerometer.serial_number),
                       accelerometer.serial_number, i,
                       fmt::format("item[{}].accelerometer.serial_number", i));
  }
}

/// Converts a list of one item into the form [item] and [accelerometer], in which the truth is along the axes
/// of the platter and faults name the accelerometer.
void take_as_one_item(BenchConfig& c) {
  BenchItemConfig& item = c.items.front();
  if (const auto mounting = mounting_matrix(item.expected.mounting)) {
    item.simulation.sensitivity_matrix *= *mounting;
    for (ChangeConfig& change : c.changes) change.truth.sensitivity_matrix *= *mounting;
  }
  constexpr std::string_view kListed = "item-1";
  for (FaultConfig& fault : c.faults)
    if (item_of_instrument(fault.instrument) == 1)
      fault.instrument.replace(0, kListed.size(), accelerometer_name(c, 1));
}

void check_listed_items(TomlReader& reader, const toml::table& root, BenchConfig& c) {
  if (root.contains("accelerometer"))
    reader.add_problem(
        "accelerometer", "a section [accelerometer] beside [[item]]",
        "[item.accelerometer] below each [[item]]; or [item] and [accelerometer] for one item");
  if (root["item"].as_array()->empty()) {
    reader.add_problem("item", "an empty list", "at least one [[item]]");
    return;
  }
  if (c.items.size() > kMostItems)
    reader.add_problem(fmt::format("item[{}]", kMostItems), fmt::format("{} items", c.items.size()),
                       fmt::format("at most {}", kMostItems));
  for (std::size_t i = 0; i < c.items.size(); ++i) {
    BenchItemConfig& item = c.items[i];
    const std::string where = fmt::format("item[{}].", i);
    check_accelerometer(reader, where + "accelerometer", item.accelerometer);
    const auto mounting = mounting_matrix(item.expected.mounting);
    if (!mounting) {
      reader.add_problem(where + "mounting", "\"" + item.expected.mounting + "\"", kMountingWords);
    } else if (mounting->determinant() < 0.0) {
      reader.add_problem(where + "mounting", "\"" + item.expected.mounting + "\", a mirror image",
                         "a rotation: one of the signs differs");
    }
    check_simulated_unit(reader, where, item);
  }
  check_ports_of_items(reader, c.items);
  check_names_of_items(reader, c.items);
}

void check_one_item(TomlReader& reader, BenchConfig& c) {
  BenchItemConfig& item = c.items.front();
  if (!mounting_matrix(item.expected.mounting))
    reader.add_problem("item.mounting", "\"" + item.expected.mounting + "\"", kMountingWords);
  check_accelerometer(reader, "accelerometer", item.accelerometer);
  check_simulated_unit(reader, "", item);
}

void check_notify(TomlReader& reader, const NotifyConfig& notify) {
  const auto begins = [](const std::string& text, std::initializer_list<std::string_view> words) {
    return std::ranges::any_of(words, [&](std::string_view word) { return text.starts_with(word); });
  };
  if (!notify.webhook.empty() && !begins(notify.webhook, {"http://", "https://", "env:"}))
    reader.add_problem("notify.webhook", "\"" + notify.webhook + "\"",
                       "http://..., https://..., or env:NAME of an environment variable that holds one");
  if (notify.mail_to.empty()) return;
  for (const auto& [key, address] :
       {std::pair{"notify.mail_to", notify.mail_to}, {"notify.mail_from", notify.mail_from}})
    if (address.find('@') == std::string::npos)
      reader.add_problem(key, address.empty() ? "nothing" : "\"" + address + "\"", "a mail address");
  if (!begins(notify.mail_server, {"smtp://", "smtps://"}))
    reader.add_problem("notify.mail_server",
                       notify.mail_server.empty() ? "nothing" : "\"" + notify.mail_server + "\"",
                       "smtp://HOST[:PORT] or smtps://HOST[:PORT]");
}

/// @param where  path of the fault
void check_lost_controller(TomlReader& reader, const std::string& where, const FaultConfig& fault,
                           const StageConfig& stage) {
  if (fault.kind != "lost-controller") return;
  const StageAxisConfig& axis = fault.axis == "z" ? stage.z : stage.x;
  const std::string& driver = stage.split() ? axis.driver : stage.driver;
  if (!makes_daisy_chains(driver))
    reader.add_problem(where + ".kind", "\"lost-controller\" with the driver \"" + driver + "\"",
                       a_driver_of_chains() + "; for another: unplug, with its own port");
}

/// @param listed  the number of items that are given as [[item]]
void check_faults_and_changes(TomlReader& reader, const BenchConfig& c, std::size_t listed) {
  for (std::size_t i = 0; i < c.faults.size(); ++i) {
    if (c.faults[i].kind.empty()) continue;  // reported already
    check_lost_controller(reader, fmt::format("fault[{}]", i), c.faults[i], c.stage);
    if (const auto problem = problem_of(c.faults[i]))
      reader.add_problem(fmt::format("fault[{}].kind", i), *problem,
                         "instrument = \"stage\" or \"accelerometer\"");
    const std::string& instrument = c.faults[i].instrument;
    const bool known = std::ranges::count(fault_instruments(), instrument) > 0;
    const auto item = item_of_instrument(instrument);
    const bool is_item = item && static_cast<std::size_t>(*item) <= listed;
    const std::string items = listed > 0 ? fmt::format(", \"item-1\" to \"item-{}\"", listed) : "";
    if (!known && !is_item)
      reader.add_problem(fmt::format("fault[{}].instrument", i), "\"" + instrument + "\"",
                         "one of " + joined(fault_instruments()) + items);
  }
  for (std::size_t i = 0; i < c.changes.size(); ++i) {
    if (static_cast<std::size_t>(c.changes[i].item) > c.items.size())
      reader.add_problem(fmt::format("change[{}].item", i), std::to_string(c.changes[i].item),
                         fmt::format("an item, 1 to {}", c.items.size()));
  }
  for (std::size_t i = 1; i < c.changes.size(); ++i) {
    if (c.changes[i].at_s < c.changes[i - 1].at_s)
      reader.add_problem(fmt::format("change[{}].at_s", i),
                         fmt::format("{} after {}", c.changes[i].at_s, c.changes[i - 1].at_s),
                         "changes in order of time");
  }
}

/// Reports a quantity that is given by both its old and its new key.
void check_stated_once(TomlReader& reader, const toml::table& root) {
  for (const EffectSizeKey& key : effect_size_keys()) {
    if (!key.was_tolerance) continue;
    const std::string before = fmt::format("tolerances.{}", key.key);
    const std::string now = fmt::format("{}.{}", key.section, key.key);
    if (root.at_path(before).node() != nullptr && root.at_path(now).node() != nullptr)
      reader.add_problem(before, fmt::format("also [{}] {}", key.section, key.key),
                         "one of them; [tolerances] is the older form");
  }
}

}  // namespace

std::optional<Problem> simulated_unit_problem(const BenchItemConfig& item) {
  // A factor between the units is 9.8; no accelerometer is off by half of that.
  constexpr double kLargestRatio = 3.0;
  const std::string unit = find_in(driver_catalogue().accelerometers, item.accelerometer.driver).output_unit;
  if (unit != "g" && unit != "m/s2") return std::nullopt;
  const double nominal = unit == "g" ? 1.0 : kStandardGravity;
  for (Eigen::Index j = 0; j < 3; ++j) {
    const double norm = item.simulation.sensitivity_matrix.row(j).norm();
    if (norm == 0.0 || (norm < kLargestRatio * nominal && norm > nominal / kLargestRatio)) continue;
    return Problem{"simulation.sensitivity_matrix",
                   fmt::format("a row with norm {:.4g} for {}, whose output is in {}", norm,
                               item.accelerometer.driver, unit),
                   fmt::format("about {:.4g} {} per g_loc", nominal, unit)};
  }
  return std::nullopt;
}

void check_together(TomlReader& reader, const toml::table& root, BenchConfig& c) {
  check_gravity(reader, root, c);
  check_stage_axes(reader, root, c);
  check_plan_and_item(reader, c);
  check_stated_once(reader, root);
  check_stage_ports(reader, c.stage);
  check_environment(reader, c.environment);
  const bool is_list = reader.is_list("item");
  if (is_list) {
    check_listed_items(reader, root, c);
  } else {
    check_one_item(reader, c);
  }
  check_notify(reader, c.notify);
  check_ports(reader, c, is_list);
  check_faults_and_changes(reader, c, is_list ? c.items.size() : 0);
  for (const Problem& problem : chamber_problems(c))
    reader.add_problem(problem.where, problem.found, problem.required);
  if (is_list && !c.has_several_items()) take_as_one_item(c);
}

}  // namespace abcal
