#include "app/bench/bench_config.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/bench/bench_keys.h"
#include "app/bench/key_visitor.h"
#include "app/bench/toml_reader.h"
#include "drivers/registry.h"
#include "protocol/gravity/local_gravity.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

std::vector<std::string> driver_names(const auto& drivers) {
  std::vector<std::string> names;
  for (const auto& driver : drivers) names.push_back(driver.name);
  names.push_back("simulated");
  return names;
}

/// What [stage] driver may be; empty where each axis has a driver of its own.
std::vector<std::string> stage_driver_names() {
  std::vector<std::string> names = driver_names(stage_drivers());
  names.insert(names.end(), {"manual_stage", ""});
  return names;
}

void visit_stage_axis(KeyVisitor& keys, const std::string& section, StageAxisConfig& axis) {
  keys.section(section);
  keys.text("axis", axis.axis);
  keys.integer("sign", axis.sign, -1, 1);
  keys.angle("zero_deg", axis.zero, kAny);
  keys.number("travel_min_deg", axis.travel_min_deg, kAny);
  keys.number("travel_max_deg", axis.travel_max_deg, kAny);
  keys.number("speed_deg_per_s", axis.speed_deg_per_s, kPositive);
  std::vector<std::string> drivers{""};
  for (const StageDriver& driver : stage_drivers()) drivers.push_back(driver.name);
  keys.text("driver", axis.driver, drivers);
  keys.text("port", axis.port);
  keys.integer("baud", axis.baud, 300, 4'000'000);
  keys.text("address", axis.address);
}

void visit_axis_truth(KeyVisitor& keys, const std::string& section, sim::AxisTruth& axis) {
  keys.section(section);
  keys.angle("mean_step_error_deg", axis.mean_step_error, kAny);
  keys.angle("initial_turn_error_deg", axis.initial_turn_error, kAny);
  keys.angle("step_error_deg", axis.step_error_sd, kNotNegative);
  keys.angle("backlash_deg", axis.backlash, kNotNegative);
  keys.angle("travel_min_deg", axis.travel_min, kAny);
  keys.angle("travel_max_deg", axis.travel_max, kAny);
  keys.number("speed_deg_per_s", axis.speed_deg_per_s, kPositive);
  keys.number("acceleration_deg_per_s2", axis.acceleration_deg_per_s2, kPositive);
  keys.angle("encoder_resolution_deg", axis.encoder_resolution, kNotNegative);
  keys.list("harmonics", axis.harmonics, sim::ErrorHarmonic{},
            [](KeyVisitor& entry, sim::ErrorHarmonic& harmonic) {
              entry.integer("order", harmonic.order, 1, 1000);
              entry.angle("sin_deg", harmonic.sin_coefficient, kAny);
              entry.angle("cos_deg", harmonic.cos_coefficient, kAny);
            });
}

void visit_output_truth(KeyVisitor& keys, sim::OutputTruth& s) {
  keys.matrix("sensitivity_matrix", s.sensitivity_matrix);
  keys.vector("offset", s.offset);
  keys.vector("k2", s.k2);
  keys.vector("k3", s.k3);
  keys.vector("drift_per_hour", s.drift_per_hour);
  keys.vector("offset_per_degc", s.offset_per_degc);
  keys.number("noise", s.noise, kNotNegative);
  keys.number("quantisation", s.quantisation, kNotNegative);
  std::optional<double> full_scale;
  if (std::isfinite(s.full_scale)) full_scale = s.full_scale;
  keys.number("full_scale", full_scale, kPositive);
  s.full_scale = full_scale.value_or(kInfinity);
  keys.number("ring_down_amplitude", s.ring_down_amplitude, kNotNegative);
  keys.number("ring_down_frequency_hz", s.ring_down_frequency_hz, kNotNegative);
  keys.number("ring_down_decay_s", s.ring_down_decay_s, kPositive);
  keys.number("temperature_degc", s.temperature_degc, {-100.0, 200.0});
  keys.number("temperature_per_hour", s.temperature_per_hour, kAny);
}

void visit_fault(KeyVisitor& keys, FaultConfig& fault) {
  keys.required_text("kind", fault.kind, fault_names());
  keys.text("instrument", fault.instrument,
            {"", "stage", "stage-x", "stage-z", "accelerometer", "accelerometer-u", "accelerometer-v",
             "accelerometer-w", "environment"});
  keys.text("axis", fault.axis, {"x", "z"});
  keys.number("at_s", fault.at_s, kNotNegative);
  keys.number("for_s", fault.for_s, kNotNegative);
  keys.integer("at_write", fault.at_write, 1, 1'000'000'000);
  keys.integer("for_writes", fault.for_writes, 1, 1'000'000'000);
  keys.number("value", fault.value, kAny);
  keys.text("output", fault.output, {"", "u", "v", "w"});
  keys.text("text", fault.text);
  keys.number("delay_s", fault.delay_s, kNotNegative);
}

void visit_change(KeyVisitor& keys, ChangeConfig& change) {
  keys.number("at_s", change.at_s, kNotNegative);
  visit_output_truth(keys, change.truth);
}

void visit(KeyVisitor& keys, BenchConfig& c) {
  keys.section("");
  keys.text("schema", c.schema, {"abcal.bench/1"});

  keys.section("bench");
  keys.text("name", c.name);
  keys.number("g_loc_mps2", c.g_loc.value_mps2, {9.5, 10.0});
  keys.number("g_loc_expanded_uncertainty_mps2", c.g_loc.expanded_uncertainty_mps2, kNotNegative);
  keys.number("g_loc_k", c.g_loc.coverage_factor, kPositive);
  keys.text("g_loc_source", c.g_loc.source);
  keys.number("latitude_deg", c.latitude_deg, {-90.0, 90.0});
  keys.number("height_m", c.height_m, {-500.0, 9000.0});

  keys.section("item");
  keys.text("maker", c.item.maker);
  keys.text("model", c.item.model);
  keys.text("serial_number", c.item.serial_number);
  keys.text("range", c.item.range);
  keys.text("filter", c.item.filter);
  keys.text("firmware", c.item.firmware);
  keys.text("supply", c.item.supply);
  keys.number("nominal_sensitivity", c.expected.nominal_sensitivity, kPositive);
  keys.number("sensitivity_tolerance", c.expected.sensitivity_tolerance, {0.0, 1.0, true});
  keys.text("mounting", c.expected.mounting);

  keys.section("operator");
  keys.text("name", c.operator_name);

  keys.section("stage");
  keys.text("driver", c.stage.driver, stage_driver_names());
  keys.text("port", c.stage.port);
  keys.integer("baud", c.stage.baud, 300, 4'000'000);
  keys.text("address", c.stage.address);
  keys.text("serial_number", c.stage.serial_number);
  keys.text("level_file", c.stage.level_file);
  visit_stage_axis(keys, "stage.x", c.stage.x);
  visit_stage_axis(keys, "stage.z", c.stage.z);

  keys.section("accelerometer");
  keys.required_text("driver", c.accelerometer.driver, driver_names(accelerometer_drivers()));
  keys.text("port", c.accelerometer.port);
  keys.integer("baud", c.accelerometer.baud, 300, 4'000'000);
  keys.number("rate_hz", c.accelerometer.rate_hz, {0.0, 10'000.0, true});
  keys.text("response_unit", c.accelerometer.response_unit);
  keys.number("full_scale", c.accelerometer.full_scale, kPositive);
  keys.text("serial_number", c.accelerometer.serial_number);
  keys.vector("scale", c.accelerometer.scale);
  keys.vector("bias", c.accelerometer.bias);
  keys.integers("channels", c.accelerometer.channels, 0, 99'999);
  keys.number("range_v", c.accelerometer.range_v, kPositive);
  keys.number("integration_plc", c.accelerometer.integration_plc, {0.0, 1000.0, true});
  keys.integers("columns", c.accelerometer.columns, 1, 1000);
  keys.text("separator", c.accelerometer.separator);
  keys.text("comment", c.accelerometer.comment);

  keys.section("environment");
  keys.number("temperature_degc", c.environment.temperature_degc, {-100.0, 200.0});
  keys.number("humidity_percent", c.environment.humidity_percent, {0.0, 100.0});
  keys.number("pressure_hpa", c.environment.pressure_hpa, {300.0, 1200.0});
  keys.text("driver", c.environment.driver, {"", "text_line"});
  keys.text("port", c.environment.port);
  keys.integer("baud", c.environment.baud, 300, 4'000'000);
  keys.integer("temperature_column", c.environment.temperature_column, 0, 1000);
  keys.integer("humidity_column", c.environment.humidity_column, 0, 1000);
  keys.integer("pressure_column", c.environment.pressure_column, 0, 1000);
  keys.text("separator", c.environment.separator);
  keys.text("comment", c.environment.comment);

  ProtocolConfig& p = c.protocol;
  keys.section("protocol");
  keys.integer("steps", p.steps, 4, 7200);
  keys.angle("step_deg", p.step, {0.0, 180.0, true});
  keys.boolean("closing_angle", p.closing_angle);
  keys.angle("approach_deg", p.approach, {0.0, 45.0});
  keys.angle("position_window_deg", p.position_window, {0.0, 5.0, true});
  keys.integer("window_polls", p.window_polls, 1, 1000);
  keys.number("poll_interval_s", p.poll_interval_s, {0.0, 10.0, true});
  keys.number("motion_timeout_s", p.motion_timeout_s, {0.0, 86'400.0, true});
  keys.number("homing_timeout_s", p.homing_timeout_s, {0.0, 86'400.0, true});
  keys.number("settle_s", p.settle_s, {0.0, 86'400.0});
  keys.number("quiet_timeout_s", p.quiet_timeout_s, {0.0, 86'400.0});
  keys.integer("dwell_readings", p.dwell_readings, 4, 1'000'000);
  keys.number("mains_hz", p.mains_hz, {0.0, 1000.0});
  keys.number("reading_timeout_s", p.reading_timeout_s, {0.0, 3600.0, true});
  keys.number("warm_up_s", p.warm_up_s, {0.0, 604'800.0});
  keys.number("replug_timeout_s", p.replug_timeout_s, {0.0, 604'800.0});
  keys.number("stability_s", p.stability_s, {0.0, 86'400.0});
  keys.number("stability_timeout_s", p.stability_timeout_s, {0.0, 604'800.0});

  Tolerances& t = c.tolerances;
  keys.section("tolerances");
  keys.angle("alignment_deg", t.alignment, {0.0, 10.0});
  keys.angle("step_deg", t.step, {0.0, 10.0});
  keys.angle("initial_turn_deg", t.initial_turn, {0.0, 10.0});
  keys.angle("zero_deg", t.zero, {0.0, 10.0});
  keys.number("drift", t.drift, {0.0, 1.0});

  keys.section("limits");
  keys.number("max_lost_fraction", c.limits.max_lost_fraction, {0.0, 1.0});
  keys.number("temperature_min_degc", c.limits.temperature_min_degc, kAny);
  keys.number("temperature_max_degc", c.limits.temperature_max_degc, kAny);
  keys.integer("max_replugs", c.limits.max_replugs, 0, 1000);
  keys.number("temperature_change_degc", c.limits.temperature_change_degc, kPositive);
  keys.number("temperature_wait_s", c.limits.temperature_wait_s, {0.0, 604'800.0});
  keys.number("spread_factor", c.limits.spread_factor, {1.0, kInfinity, true});
  keys.integer("repeats", c.limits.repeats, 0, 1000);
  keys.number("norm_fraction", c.limits.norm_fraction, kPositive);
  keys.number("stability", c.limits.stability, kPositive);
  keys.number("stability_degc", c.limits.stability_degc, kPositive);
  keys.angle("mounting_deg", c.limits.mounting, {0.0, 180.0, true});
  keys.angle("slip_deg", c.limits.slip, {0.0, 180.0, true});
  keys.angle("angle_deg", c.limits.angle, {0.0, 180.0, true});
  keys.number("drift", c.limits.drift, kPositive);

  sim::BenchTruth& s = c.simulation;
  keys.section("simulation");
  keys.seed("seed", s.seed);
  visit_output_truth(keys, s);
  keys.boolean("noise_seeded_by_angle", s.noise_seeded_by_angle);
  keys.number("zx", s.zx, {-0.1, 0.1});
  keys.number("zy", s.zy, {-0.1, 0.1});
  keys.number("xz", s.xz, {-0.1, 0.1});
  visit_axis_truth(keys, "simulation.x", s.x);
  visit_axis_truth(keys, "simulation.z", s.z);

  keys.section("simulation.link");
  double latency_s = to_seconds(c.link.latency), jitter_s = to_seconds(c.link.jitter);
  keys.number("latency_s", latency_s, {0.0, 60.0});
  keys.number("jitter_s", jitter_s, {0.0, 60.0});
  c.link = {from_seconds(latency_s), from_seconds(jitter_s)};

  keys.section("");
  keys.list("fault", c.faults, FaultConfig{}, visit_fault);
  keys.tables("change", c.changes.size(), [&](std::size_t i) {
    // What a change does not name stays as it was.
    if (i >= c.changes.size()) c.changes.push_back({0.0, i == 0 ? c.simulation : c.changes[i - 1].truth});
    visit_change(keys, c.changes[i]);
  });
}

class TomlWriter final : public KeyVisitor {
 public:
  void section(const std::string& path) override {
    if (!path.empty()) text_ += "\n[" + path + "]\n";
    path_ = path;
  }
  void text(const std::string& key, std::string& value, const std::vector<std::string>&) override {
    std::ostringstream quoted;
    quoted << toml::toml_formatter(toml::value<std::string>(value));
    line(key, quoted.str());
  }
  void required_text(const std::string& key, std::string& value,
                     const std::vector<std::string>& choices) override {
    text(key, value, choices);
  }
  void number(const std::string& key, double& value, Range) override { line(key, real(value)); }
  void number(const std::string& key, std::optional<double>& value, Range) override {
    if (value) line(key, real(*value));
  }
  void integer(const std::string& key, int& value, int, int) override { line(key, std::to_string(value)); }
  void integer(const std::string& key, std::optional<int>& value, int, int) override {
    if (value) line(key, std::to_string(*value));
  }
  void seed(const std::string& key, std::uint64_t& value) override { line(key, std::to_string(value)); }
  void boolean(const std::string& key, bool& value) override { line(key, value ? "true" : "false"); }
  void vector(const std::string& key, Eigen::Vector3d& value) override { line(key, triple(value)); }
  void matrix(const std::string& key, Eigen::Matrix3d& value) override {
    line(key, fmt::format("[{}, {}, {}]", triple(value.row(0)), triple(value.row(1)), triple(value.row(2))));
  }
  void integers(const std::string& key, std::array<int, 3>& value, int, int) override {
    line(key, fmt::format("[{}, {}, {}]", value[0], value[1], value[2]));
  }
  void tables(const std::string& key, std::size_t size,
              const std::function<void(std::size_t)>& visit_entry) override {
    for (std::size_t i = 0; i < size; ++i) {
      text_ += "\n[[" + (path_.empty() ? key : path_ + "." + key) + "]]\n";
      visit_entry(i);
    }
  }
  std::string take() { return std::move(text_); }

 private:
  /// The shortest digits that read back as the same number; with a point, so that TOML sees no integer.
  static std::string real(double value) {
    std::string digits = fmt::format("{}", value);
    if (digits.find_first_of(".en") == std::string::npos) digits += ".0";
    return digits;
  }
  static std::string triple(const Eigen::Vector3d& v) {
    return fmt::format("[{}, {}, {}]", real(v[0]), real(v[1]), real(v[2]));
  }
  void line(const std::string& key, const std::string& value) { text_ += key + " = " + value + "\n"; }

  std::string text_;
  std::string path_;
};

constexpr const char* kPortWords = "a port: a path, usb:VID:PID[:SERIAL], tcp:HOST:PORT, or \"simulated\"";

/// One controller for both axes, or one for each; what needs bytes has a port.
void check_stage_ports(TomlReader& reader, StageConfig& stage) {
  if (!stage.split()) {
    if (stage.driver.empty())
      reader.add_problem("stage.driver", "nothing", "one of " + joined(stage_driver_names()));
    const bool no_bytes = stage.driver == "simulated" || stage.driver == "manual_stage";
    if (no_bytes && stage.port.empty()) stage.port = stage.driver;
    if (no_bytes && stage.port != stage.driver)
      reader.add_problem("stage.port", "\"" + stage.port + "\"",
                         "\"" + stage.driver + "\", as the driver is");
    if (stage.port.empty()) reader.add_problem("stage.port", "nothing", kPortWords);
    for (const auto& [section, axis] : {std::pair{"stage.x", &stage.x}, std::pair{"stage.z", &stage.z}}) {
      if (!axis->port.empty())
        reader.add_problem(std::string(section) + ".port", "\"" + axis->port + "\"",
                           "a driver beside it, and both for the other axis, or neither");
    }
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
  }
}

void check_together(TomlReader& reader, const toml::table& root, BenchConfig& c) {
  const bool value_given = root.at_path("bench.g_loc_mps2").node() != nullptr;
  if (!value_given && !(c.latitude_deg && c.height_m)) {
    reader.add_problem("bench.g_loc_mps2", "neither g_loc_mps2 nor latitude_deg and height_m",
                       "local gravity in m/s2 (a survey is best), or latitude and height for a formula");
  } else if (!value_given && std::isfinite(*c.latitude_deg) && std::isfinite(*c.height_m)) {
    const FormulaGravity formula = formula_gravity(Angle::degrees(*c.latitude_deg), *c.height_m);
    c.g_loc = {formula.value_mps2, 2.0 * formula.standard_uncertainty_mps2, 2.0, formula.source};
    c.warnings.push_back(formula.warning);
  }
  const auto check_travel = [&](const std::string& section, const auto& min, const auto& max) {
    if (min && max && !(*min < *max)) {
      reader.add_problem(section + ".travel_min_deg", fmt::format("{} to {}", *min, *max),
                         "travel_min_deg < travel_max_deg");
    }
  };
  check_travel("stage.x", c.stage.x.travel_min_deg, c.stage.x.travel_max_deg);
  check_travel("stage.z", c.stage.z.travel_min_deg, c.stage.z.travel_max_deg);
  for (const auto& [section, axis] :
       {std::pair{"stage.x.sign", &c.stage.x}, std::pair{"stage.z.sign", &c.stage.z}}) {
    if (axis->sign == 0) reader.add_problem(section, "0", "1 or -1");
  }
  if (!c.stage.split() && c.stage.x.axis == c.stage.z.axis) {
    reader.add_problem("stage.z.axis", "\"" + c.stage.z.axis + "\", the same as [stage.x] axis",
                       "two different axes");
  }
  if (c.protocol.step.deg() * (c.protocol.steps - 1) >= 360.0) {
    reader.add_problem("protocol.steps",
                       fmt::format("{} steps of {} deg", c.protocol.steps, c.protocol.step.deg()),
                       "steps * step_deg <= 360");
  }
  if (!(c.limits.temperature_min_degc < c.limits.temperature_max_degc)) {
    reader.add_problem("limits.temperature_min_degc",
                       fmt::format("{} to {}", c.limits.temperature_min_degc, c.limits.temperature_max_degc),
                       "temperature_min_degc < temperature_max_degc");
  }
  if (!mounting_matrix(c.expected.mounting)) {
    reader.add_problem("item.mounting", "\"" + c.expected.mounting + "\"",
                       "the axes along which u, v and w point, each once, as \"x y z\" or \"-y x z\"");
  }
  check_stage_ports(reader, c.stage);
  if (c.accelerometer.driver == "simulated") {
    if (c.accelerometer.port.empty()) c.accelerometer.port = "simulated";
    if (c.accelerometer.port != "simulated")
      reader.add_problem("accelerometer.port", "\"" + c.accelerometer.port + "\"",
                         "\"simulated\", as the driver is");
  } else if (c.accelerometer.port.empty()) {
    reader.add_problem("accelerometer.port", "nothing", kPortWords);
  }
  if (c.environment.driver.empty() != c.environment.port.empty())
    reader.add_problem(c.environment.port.empty() ? "environment.port" : "environment.driver", "nothing",
                       "driver and port, or neither");
  for (int j = 0; j < 3; ++j) {
    if (c.accelerometer.scale[j] == 0.0) reader.add_problem("accelerometer.scale", "0", "no zeros");
  }
  for (std::size_t i = 0; i < c.faults.size(); ++i) {
    if (c.faults[i].kind.empty()) continue;  // reported already
    if (const auto problem = problem_of(c.faults[i]))
      reader.add_problem(fmt::format("fault[{}].kind", i), *problem,
                         "instrument = \"stage\" or \"accelerometer\"");
  }
  for (std::size_t i = 1; i < c.changes.size(); ++i) {
    if (c.changes[i].at_s < c.changes[i - 1].at_s)
      reader.add_problem(fmt::format("change[{}].at_s", i),
                         fmt::format("{} after {}", c.changes[i].at_s, c.changes[i - 1].at_s),
                         "changes in order of time");
  }
}

}  // namespace

void visit_bench_keys(KeyVisitor& keys, BenchConfig& config) {
  visit(keys, config);
}

BenchError::BenchError(const std::string& file, std::vector<Problem> problems)
    : std::runtime_error([&] {
        std::string text = fmt::format("bench file {}: {} problem{}", file, problems.size(),
                                       problems.size() == 1 ? "" : "s");
        for (const Problem& problem : problems) text += "\n  " + to_string(problem);
        return text;
      }()),
      problems_(std::move(problems)) {}

BenchConfig parse_bench(std::string_view text, const std::string& source) {
  std::vector<Problem> unreadable;
  const toml::table root =
      parse_toml(text, source, "a bench file; docs/examples holds commented ones", unreadable);
  if (!unreadable.empty()) throw BenchError(source, std::move(unreadable));
  BenchConfig config;
  TomlReader reader(root);
  visit(reader, config);
  check_together(reader, root, config);
  reader.report_unknown();
  if (auto problems = reader.take_problems(); !problems.empty())
    throw BenchError(source, std::move(problems));
  return config;
}

BenchConfig read_bench(const std::filesystem::path& path) {
  std::vector<Problem> unreadable;
  const std::string text = read_text_file(path.string(), "bench file", unreadable);
  if (!unreadable.empty()) throw BenchError(path.string(), std::move(unreadable));
  return parse_bench(text, path.string());
}

namespace {

/// JSON as TOML, so that one reader checks both.
toml::table table_from(const nlohmann::json& json);
toml::array array_from(const nlohmann::json& json);

void insert(const nlohmann::json& value, const auto& put) {
  if (value.is_boolean()) {
    put(value.get<bool>());
  } else if (value.is_number_integer()) {
    put(value.get<std::int64_t>());
  } else if (value.is_number()) {
    put(value.get<double>());
  } else if (value.is_string()) {
    put(value.get<std::string>());
  } else if (value.is_array()) {
    put(array_from(value));
  } else if (value.is_object()) {
    put(table_from(value));
  }  // null: as if the key were absent
}

toml::table table_from(const nlohmann::json& json) {
  toml::table table;
  for (const auto& [key, value] : json.items()) {
    insert(value, [&, name = key](auto&& v) { table.insert_or_assign(name, std::move(v)); });
  }
  return table;
}

toml::array array_from(const nlohmann::json& json) {
  toml::array array;
  for (const nlohmann::json& entry : json) insert(entry, [&](auto&& v) { array.push_back(std::move(v)); });
  return array;
}

/// Reads one table with `visit_entry`; every problem at once.
void parse_one(const std::string& json, const std::function<void(KeyVisitor&)>& visit_entry) {
  const nlohmann::json object = nlohmann::json::parse(json, nullptr, false);
  if (!object.is_object()) throw BenchError("line", {{"the line", "no JSON object", "a JSON object"}});
  const toml::table table = table_from(object);
  TomlReader reader(table);
  reader.section("");
  visit_entry(reader);
  reader.report_unknown();
  if (auto problems = reader.take_problems(); !problems.empty())
    throw BenchError("line", std::move(problems));
}

}  // namespace

FaultConfig parse_fault(const std::string& json) {
  FaultConfig fault;
  parse_one(json, [&](KeyVisitor& keys) { visit_fault(keys, fault); });
  if (const auto problem = problem_of(fault))
    throw BenchError("line", {{"instrument", *problem, "one of both"}});
  return fault;
}

ChangeConfig parse_change(const std::string& json, const sim::OutputTruth& now) {
  ChangeConfig change{0.0, now};
  parse_one(json, [&](KeyVisitor& keys) { visit_change(keys, change); });
  return change;
}

std::string write_bench(const BenchConfig& config) {
  BenchConfig copy = config;
  TomlWriter writer;
  visit(writer, copy);
  return writer.take();
}

}  // namespace abcal
