#include "app/bench_file/bench_keys.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "app/bench_file/effect_keys.h"
#include "app/bench_file/key_ranges.h"
#include "app/bench_file/stated_truth.h"
#include "drivers/instrument/driver_catalogue.h"
#include "protocol/plan/faces.h"

namespace abcal {
namespace {

/// Appends the names of the drivers that have a port, or of those that have none.
void append_names(std::vector<std::string>& names, const std::vector<CataloguedDriver>& drivers,
                  bool has_port = true) {
  for (const CataloguedDriver& driver : drivers)
    if (driver.has_port == has_port) names.push_back(driver.name);
}

/// Temperatures that no chamber exceeds, in degC.
constexpr Range kChamberRange{-200.0, 400.0};

void visit_stage_axis(KeyVisitor& keys, const std::string& section, StageAxisConfig& axis) {
  keys.section(section);
  keys.text("axis", axis.axis);
  keys.integer("sign", axis.sign, -1, 1);
  keys.angle("zero_deg", axis.zero, kTurns);
  keys.number("travel_min_deg", axis.travel_min_deg, kTurns);
  keys.number("travel_max_deg", axis.travel_max_deg, kTurns);
  keys.number("speed_deg_per_s", axis.speed_deg_per_s, kSpeed);
  keys.number("wraps_deg", axis.wraps_deg, {360.0, 360.0});
  keys.number("units_per_degree", axis.units_per_degree, {1e-9, 1e12});
  std::vector<std::string> drivers{""};
  append_names(drivers, driver_catalogue().stages);
  keys.text("driver", axis.driver, drivers);
  keys.text("port", axis.port);
  keys.integer("baud", axis.baud, 300, 4'000'000);
  keys.text("address", axis.address);
}

void visit_axis_truth(KeyVisitor& keys, const std::string& section, sim::AxisTruth& axis) {
  keys.section(section);
  keys.angle("mean_step_error_deg", axis.mean_step_error, kAngle);
  keys.angle("initial_turn_error_deg", axis.initial_turn_error, kAngle);
  keys.angle("step_error_deg", axis.step_error_sd, kAngleSize);
  keys.angle("backlash_deg", axis.backlash, kAngleSize);
  keys.angle("travel_min_deg", axis.travel_min, kTurns);
  keys.angle("travel_max_deg", axis.travel_max, kTurns);
  keys.number("speed_deg_per_s", axis.speed_deg_per_s, kSpeed);
  keys.number("acceleration_deg_per_s2", axis.acceleration_deg_per_s2, kAcceleration);
  keys.angle("encoder_resolution_deg", axis.encoder_resolution, kAngleSize);
  keys.number("rate_ripple", axis.rate_ripple, {0.0, 0.1});
  visit_axis_effects(keys, axis);
  keys.list("harmonics", axis.harmonics, sim::ErrorHarmonic{},
            [](KeyVisitor& entry, sim::ErrorHarmonic& harmonic) {
              entry.integer("order", harmonic.order, 1, 1000);
              entry.angle("sin_deg", harmonic.sin_coefficient, kAngle);
              entry.angle("cos_deg", harmonic.cos_coefficient, kAngle);
            });
  visit_axis_wobble(keys, axis);
}

constexpr Range kPosition{-1000.0, 1000.0};

void visit_output_truth(KeyVisitor& keys, sim::OutputTruth& s) {
  keys.matrix("sensitivity_matrix", s.sensitivity_matrix, kResponse);
  keys.vector("offset", s.offset, kResponse);
  keys.vector("k2", s.k2, kSecondOrder);
  keys.vector("k3", s.k3, kThirdOrder);
  keys.vector("drift_per_hour", s.drift_per_hour, kResponse);
  keys.vector("offset_per_degc", s.offset_per_degc, kResponse);
  keys.number("noise", s.noise, kResponseSize);
  keys.number("quantisation", s.quantisation, kResponseSize);
  std::optional<double> full_scale;
  if (std::isfinite(s.full_scale)) full_scale = s.full_scale;
  keys.number("full_scale", full_scale, kPositiveResponse);
  s.full_scale = full_scale.value_or(kInfinity);
  keys.number("ring_down_amplitude", s.ring_down_amplitude, kResponseSize);
  keys.number("ring_down_frequency_hz", s.ring_down_frequency_hz, kFrequency);
  keys.number("ring_down_decay_s", s.ring_down_decay_s, kTime);
  keys.number("temperature_degc", s.temperature_degc, {-100.0, 200.0});
  keys.number("temperature_per_hour", s.temperature_per_hour, kTemperatureRate);
  visit_output_effects(keys, s);
  keys.vector("offset_per_degc2", s.offset_per_degc2, kResponse);
  keys.vector("offset_per_degc3", s.offset_per_degc3, kResponse);
  keys.vector("sensitivity_per_degc", s.sensitivity_per_degc, kRelativeChange);
  keys.vector("sensitivity_per_degc2", s.sensitivity_per_degc2, kRelativeChange);
  keys.vector("sensitivity_per_degc3", s.sensitivity_per_degc3, kRelativeChange);
  keys.vector("offset_thermal_hysteresis", s.offset_thermal_hysteresis, kResponse);
  keys.vector("sensitivity_thermal_hysteresis", s.sensitivity_thermal_hysteresis, kRelativeChange);
  keys.number("low_pass_hz", s.low_pass_hz, {0.0, 1e6});
  keys.integer("low_pass_order", s.low_pass_order, 1, 2);
  keys.number("group_delay_s", s.group_delay_s, {0.0, 10.0});
  keys.number("time_stamp_jitter_s", s.time_stamp_jitter_s, {0.0, 1.0});
  keys.vector("rate_offset", s.rate_offset, kResponse);
  keys.vector("position_u_mm", s.position_u_mm, kPosition);
  keys.vector("position_v_mm", s.position_v_mm, kPosition);
  keys.vector("position_w_mm", s.position_w_mm, kPosition);
}

void visit_bench(KeyVisitor& keys, BenchConfig& c) {
  keys.section("bench");
  keys.text("name", c.name);
  CalibratedNumber gravity{c.g_loc.value_mps2, c.g_loc.expanded_uncertainty_mps2, c.g_loc.coverage_factor,
                           c.g_loc.source};
  keys.calibrated("g_loc_mps2", gravity, {9.5, 10.0}, "m/s2");
  c.g_loc = {gravity.value, gravity.expanded_uncertainty, gravity.coverage_factor, gravity.source};
  keys.number("g_loc_expanded_uncertainty_mps2", c.g_loc.expanded_uncertainty_mps2, {0.0, 1.0});
  keys.number("g_loc_k", c.g_loc.coverage_factor, {0.0, 100.0, true});
  keys.text("g_loc_source", c.g_loc.source);
  keys.number("latitude_deg", c.latitude_deg, {-90.0, 90.0});
  keys.number("height_m", c.height_m, {-500.0, 9000.0});
}

void visit_item(KeyVisitor& keys, ItemConfig& item, ExpectedItem& expected) {
  keys.text("maker", item.maker);
  keys.text("model", item.model);
  keys.text("serial_number", item.serial_number);
  keys.text("customer_number", item.customer_number);
  keys.text("range", item.range);
  keys.text("filter", item.filter);
  keys.text("firmware", item.firmware);
  keys.text("supply", item.supply);
  keys.number("nominal_sensitivity", expected.nominal_sensitivity, kPositiveResponse);
  keys.number("sensitivity_tolerance", expected.sensitivity_tolerance, {0.0, 1.0, true});
  keys.text("mounting", expected.mounting);
  keys.text("reference_surface", item.reference_surface);
  keys.text("direction_marks", item.direction_marks);
  keys.text("fasteners", item.fasteners);
  keys.number("torque_newton_metre", item.torque_newton_metre, kTorque);
  keys.text("cable", item.cable);
}

void visit_stage(KeyVisitor& keys, StageConfig& stage) {
  keys.section("stage");
  keys.text("driver", stage.driver, stage_driver_names());
  keys.text("port", stage.port);
  keys.integer("baud", stage.baud, 300, 4'000'000);
  keys.text("address", stage.address);
  keys.text("serial_number", stage.serial_number);
  keys.text("unit", stage.unit, {"", "deg"});
  keys.text("level_file", stage.level_file);
  keys.text("record", stage.record);
  keys.text("description", stage.description);
  keys.text("description_text", stage.description_text);
  visit_stage_axis(keys, "stage.x", stage.x);
  visit_stage_axis(keys, "stage.z", stage.z);
}

void visit_accelerometer(KeyVisitor& keys, AccelerometerConfig& a) {
  AccelerometerSettings& settings = a.settings;
  std::vector<std::string> drivers;
  append_names(drivers, driver_catalogue().accelerometers);
  drivers.emplace_back("simulated");
  keys.required_text("driver", a.driver, drivers);
  keys.text("port", a.port);
  keys.integer("baud", a.baud, 300, 4'000'000);
  keys.number("rate_hz", settings.rate_hz, {0.0, 10'000.0, true});
  keys.text("response_unit", settings.unit);
  keys.number("full_scale", settings.full_scale, kPositiveResponse);
  keys.text("serial_number", a.serial_number);
  keys.vector("scale", settings.scale, kResponse);
  keys.vector("bias", settings.bias, kResponse);
  keys.integers("channels", settings.channels, 0, 99'999);
  keys.number("range_v", settings.range_v, {1e-9, 1e6});
  keys.number("integration_plc", settings.integration_plc, {0.0, 1000.0, true});
  keys.integers("columns", settings.columns, 1, 1000);
  keys.text("separator", settings.separator);
  keys.text("comment", settings.comment);
  keys.text("names", settings.names);
  keys.text("number_unit", settings.number_unit);
  keys.text("decimal_mark", settings.decimal_mark, {".", ","});
}

void visit_environment(KeyVisitor& keys, EnvironmentConfig& e) {
  keys.section("environment");
  keys.number("temperature_degc", e.temperature_degc, {-100.0, 200.0});
  keys.number("humidity_percent", e.humidity_percent, {0.0, 100.0});
  keys.number("pressure_hpa", e.pressure_hpa, {300.0, 1200.0});
  std::vector<std::string> drivers{""};
  append_names(drivers, driver_catalogue().environments);
  keys.text("driver", e.driver, drivers);
  keys.text("port", e.port);
  keys.integer("baud", e.baud, 300, 4'000'000);
  keys.integer("temperature_column", e.settings.temperature_column, 0, 1000);
  keys.integer("humidity_column", e.settings.humidity_column, 0, 1000);
  keys.integer("pressure_column", e.settings.pressure_column, 0, 1000);
  keys.text("separator", e.settings.separator);
  keys.text("comment", e.settings.comment);
}

void visit_chamber(KeyVisitor& keys, ChamberConfig& chamber) {
  keys.section("chamber");
  std::vector<std::string> drivers{""};
  const std::vector<CataloguedDriver> chambers = driver_catalogue().chambers;
  append_names(drivers, chambers);
  append_names(drivers, chambers, false);
  keys.text("driver", chamber.driver, drivers);
  keys.text("port", chamber.port);
  keys.integer("baud", chamber.baud, 300, 4'000'000);
  keys.text("model", chamber.settings.model, {"", "F4", "F4T", "simserv", "ascii2"});
  keys.integer("address", chamber.settings.address, 1, 247);
  keys.boolean("humidity", chamber.settings.humidity);
  keys.integer("run_output", chamber.settings.run_output, 1, 32);
  keys.integer("pause_output", chamber.settings.pause_output, 0, 32);
  keys.integer("door_input", chamber.settings.door_input, 0, 32);
  keys.text("serial_number", chamber.settings.serial_number);
  keys.number("min_degc", chamber.min_degc, kChamberRange);
  keys.number("max_degc", chamber.max_degc, kChamberRange);
  keys.boolean("dry_gas", chamber.dry_gas);
  keys.number("poll_s", chamber.poll_s, {0.1, 60.0});
}

void visit_temperature(KeyVisitor& keys, TemperatureConfig& t) {
  keys.section("temperature");
  keys.numbers("set_points_degc", t.set_points_degc, kChamberRange);
  keys.number("reference_degc", t.reference_degc, kChamberRange);
  keys.boolean("down", t.down);
  keys.number("ramp_k_per_min", t.ramp_k_per_min, {0.0, 100.0});
  keys.number("air_window_k", t.air_window_k, {0.0, 50.0, true});
  keys.number("soak_min_s", t.soak_min_s, {0.0, 604'800.0});
  keys.number("soak_rate_k_per_min", t.soak_rate_k_per_min, {0.0, 100.0});
  keys.number("soak_span_s", t.soak_span_s, {1.0, 86'400.0});
  keys.number("soak_max_s", t.soak_max_s, {0.0, 604'800.0});
  keys.number("item_min_degc", t.item_min_degc, kChamberRange);
  keys.number("item_max_degc", t.item_max_degc, kChamberRange);
  keys.number("dew_point_margin_k", t.dew_point_margin_k, {0.0, 50.0});
  keys.boolean("pause", t.pause);
  keys.text("end", t.end, {"hold", "ambient", "off"});
}

/// Up to here the uncertainties are known to cover (docs/constant_rate.md).
constexpr Range kSweepRate{0.0, 180.0, true};

void visit_protocol(KeyVisitor& keys, ProtocolConfig& p) {
  keys.section("protocol");
  keys.integer("steps", p.steps, 4, 7200);
  keys.angle("step_deg", p.step, {0.0, 180.0, true});
  keys.integer("faces", p.faces, 1, 2);
  keys.text("estimator", p.estimator, {kEstimatorNames.begin(), kEstimatorNames.end()});
  keys.text("motion", p.motion, {kMotionNames.begin(), kMotionNames.end()});
  keys.numbers("rate_deg_per_s", p.rate_deg_per_s, kSweepRate);
  keys.integer("sweeps", p.sweeps, 1, 100);
  keys.integer("stops", p.stops, 0, 72);
  keys.number("acceleration_deg_per_s2", p.acceleration_deg_per_s2, kAcceleration);
  keys.boolean("closing_angle", p.closing_angle);
  keys.boolean("check_poses", p.check_poses);
  keys.angle("approach_deg", p.approach, {0.0, 45.0});
  keys.angle("position_window_deg", p.position_window, {0.0, 5.0, true});
  keys.integer("window_polls", p.window_polls, 1, 1000);
  keys.number("poll_interval_s", p.poll_interval_s, {0.0, 10.0, true});
  keys.number("motion_timeout_s", p.motion_timeout_s, {0.0, 86'400.0, true});
  keys.number("homing_timeout_s", p.homing_timeout_s, {0.0, 86'400.0, true});
  keys.number_or_auto("settle_s", p.settle_s, p.settle_auto, {0.0, 86'400.0});
  keys.number("quiet_timeout_s", p.quiet_timeout_s, {0.0, 86'400.0});
  keys.integer("dwell_readings", p.dwell_readings, 4, 1'000'000);
  keys.number("mains_hz", p.mains_hz, {0.0, 1000.0});
  keys.number("reading_timeout_s", p.reading_timeout_s, {0.0, 3600.0, true});
  keys.number("warm_up_s", p.warm_up_s, {0.0, 604'800.0});
  keys.number("replug_timeout_s", p.replug_timeout_s, {0.0, 604'800.0});
  keys.number("stability_s", p.stability_s, {0.0, 86'400.0});
  keys.number("stability_timeout_s", p.stability_timeout_s, {0.0, 604'800.0});
}

void visit_limits(KeyVisitor& keys, LimitsConfig& l) {
  keys.number("max_lost_fraction", l.max_lost_fraction, {0.0, 1.0});
  keys.number("temperature_min_degc", l.temperature_min_degc, kTemperatureLimit);
  keys.number("temperature_max_degc", l.temperature_max_degc, kTemperatureLimit);
  keys.integer("max_replugs", l.max_replugs, 0, 1000);
  keys.number("temperature_change_degc", l.temperature_change_degc, kLimit);
  keys.number("temperature_wait_s", l.temperature_wait_s, {0.0, 604'800.0});
  keys.number("spread_factor", l.spread_factor, {1.0, kNoLimit, true});
  keys.integer("repeats", l.repeats, 0, 1000);
  keys.number("norm_fraction", l.norm_fraction, kLimit);
  keys.number("stability", l.stability, kLimit);
  keys.number("stability_degc", l.stability_degc, kLimit);
  keys.angle("mounting_deg", l.mounting, {0.0, 180.0, true});
  keys.angle("slip_deg", l.slip, {0.0, 180.0, true});
  keys.angle("angle_deg", l.angle, {0.0, 180.0, true});
  keys.number("drift", l.drift, kLimit);
}

/// @param output  truth of the only item, or default of all items; null: each item states its own
void visit_simulation(KeyVisitor& keys, BenchConfig& c, sim::OutputTruth* output) {
  sim::StageTruth& s = c.simulation;
  keys.section("simulation");
  keys.text("draw", c.draw, {"", kDrawStated});
  keys.seed("seed", s.seed);
  if (output != nullptr) visit_output_truth(keys, *output);
  keys.boolean("noise_seeded_by_angle", s.noise_seeded_by_angle);
  keys.number("zx", s.zx, {-0.1, 0.1});
  keys.number("zy", s.zy, {-0.1, 0.1});
  keys.number("xz", s.xz, {-0.1, 0.1});
  keys.number("zx_per_degc", s.zx_per_degc, {-1e-3, 1e-3});
  visit_world_effects(keys, s);
  keys.number("axes_distance_mm", s.axes_distance_mm, {-1000.0, 1000.0});
  keys.number("encoder_latency_s", s.encoder_latency_s, {0.0, 10.0});
  keys.number("encoder_jitter_s", s.encoder_jitter_s, {0.0, 1.0});
  keys.section("simulation.chamber");
  keys.number("air_lag_s", s.chamber.air_lag_s, kTime);
  keys.number("item_lag_s", s.chamber.item_lag_s, kTime);
  keys.number("self_heating_degc", s.chamber.self_heating_degc, kHeating);
  keys.number("dew_point_degc", s.chamber.dew_point_degc, {-100.0, 60.0});
  keys.number("hysteresis_width_degc", s.chamber.hysteresis_width_degc, kTemperatureWidth);
  visit_axis_truth(keys, "simulation.x", s.x);
  visit_axis_truth(keys, "simulation.z", s.z);
}

void visit_link(KeyVisitor& keys, sim::LinkTiming& link) {
  keys.section("simulation.link");
  double latency_s = to_seconds(link.latency), jitter_s = to_seconds(link.jitter);
  keys.number("latency_s", latency_s, {0.0, 60.0});
  keys.number("jitter_s", jitter_s, {0.0, 60.0});
  link = {from_seconds(latency_s), from_seconds(jitter_s)};
}

void visit_notify(KeyVisitor& keys, NotifyConfig& notify) {
  keys.section("notify");
  keys.text("webhook", notify.webhook);
  keys.text("mail_to", notify.mail_to);
  keys.text("mail_from", notify.mail_from);
  keys.text("mail_server", notify.mail_server);
}

void visit_emulated_accelerometer(KeyVisitor& keys, BenchItemConfig& item) {
  keys.text("accelerometer_model", item.accelerometer_model);
  keys.text("at_power_on", item.at_power_on, {"", "streaming", "silent"});
  keys.integer("serial_port", item.serial_port, 1, 2);
}

/// @param item  as `output` of visit_simulation()
void visit_emulator(KeyVisitor& keys, EmulatorConfig& emulator, BenchItemConfig* item) {
  keys.section("emulator");
  keys.text("line", emulator.line, {"real", "ideal"});
  keys.text("stage_model", emulator.stage_model);
  keys.text("chamber_model", emulator.chamber_model, {"", "F4S", "F4D"});
  keys.boolean("chamber_in_fahrenheit", emulator.chamber_in_fahrenheit);
  if (item != nullptr) visit_emulated_accelerometer(keys, *item);
}

void visit_list_item(KeyVisitor& keys, BenchItemConfig& item) {
  visit_item(keys, item.item, item.expected);
  keys.table("accelerometer", [&] { visit_accelerometer(keys, item.accelerometer); });
  keys.table("item_uncertainty", [&] { visit_item_effect_sizes(keys, item.tolerances); });
  keys.table("limits", [&] { visit_limits(keys, item.limits); });
  keys.table("simulation", [&] { visit_output_truth(keys, item.simulation); });
  keys.table("emulator", [&] { visit_emulated_accelerometer(keys, item); });
}

/// The form [[item]], after the sections whose values are the defaults of every item.
void visit_list_of_items(KeyVisitor& keys, BenchConfig& c) {
  BenchItemConfig fresh = c.items.front();
  fresh.item = {};
  fresh.expected = {};
  fresh.accelerometer = {};
  std::vector<BenchItemConfig> items;
  if (keys.writes()) items = c.items;
  keys.list("item", items, fresh, visit_list_item);
  if (!items.empty()) c.items = std::move(items);
}

/// @param is_list  the items are given as [[item]]
void visit_change_of_bench(KeyVisitor& keys, BenchConfig& c, std::size_t i, bool is_list) {
  ChangeConfig& change = c.changes[i];
  if (is_list || keys.shows_every_form()) keys.integer("item", change.item, 1, static_cast<int>(kMostItems));
  if (keys.writes() || keys.shows_every_form()) return visit_change(keys, change);
  // Quantities that a change does not name keep their values. A number that no item has is reported later.
  const auto item = std::min(static_cast<std::size_t>(change.item), c.items.size());
  change.truth = c.items[item - 1].simulation;
  for (std::size_t before = 0; before < i; ++before)
    if (c.changes[before].item == change.item) change.truth = c.changes[before].truth;
  visit_change(keys, change);
}

}  // namespace

std::vector<std::string> stage_driver_names() {
  const std::vector<CataloguedDriver> stages = driver_catalogue().stages;
  std::vector<std::string> names;
  append_names(names, stages);
  names.emplace_back("simulated");
  append_names(names, stages, false);
  names.emplace_back("");
  return names;
}

void visit_fault(KeyVisitor& keys, FaultConfig& fault) {
  keys.required_text("kind", fault.kind, fault_names());
  // Which names exist depends on the items: bench_consistency.cc checks them.
  keys.text("instrument", fault.instrument,
            keys.shows_every_form() ? fault_instruments() : std::vector<std::string>{});
  keys.text("axis", fault.axis, {"x", "z"});
  keys.number("at_s", fault.at_s, kTimeOrZero);
  keys.number("for_s", fault.for_s, kTimeOrZero);
  keys.integer("at_write", fault.at_write, 1, 1'000'000'000);
  keys.integer("for_writes", fault.for_writes, 1, 1'000'000'000);
  keys.number("value", fault.value, kResponse);
  keys.text("output", fault.output, {"", "u", "v", "w"});
  keys.text("text", fault.text);
  keys.number("delay_s", fault.delay_s, kTimeOrZero);
}

void visit_change(KeyVisitor& keys, ChangeConfig& change) {
  keys.number("at_s", change.at_s, kTimeOrZero);
  visit_output_truth(keys, change.truth);
}

void visit_bench_file(KeyVisitor& keys, BenchConfig& c) {
  keys.section("");
  keys.text("schema", c.schema, {"abcal.bench/2", "abcal.bench/1"});
  c.schema = "abcal.bench/2";  // The configuration is kept, and written, in the terms of this schema.
  visit_bench(keys, c);
  // A list of one item is accepted; a single item is written in the form [item].
  const bool is_list = keys.writes() ? c.has_several_items() : keys.is_list("item");
  const bool shows_one = !is_list || keys.shows_every_form();
  // In a file, the sections of an item above a list are defaults; a written list states every value itself.
  BenchItemConfig& first = c.items.front();
  const bool states_items = !(keys.writes() && is_list);
  if (shows_one) {
    keys.section("item");
    visit_item(keys, first.item, first.expected);
  }
  keys.section("operator");
  keys.text("name", c.operator_name);
  visit_stage(keys, c.stage);
  if (shows_one) {
    keys.section("accelerometer");
    visit_accelerometer(keys, first.accelerometer);
  }
  visit_environment(keys, c.environment);
  visit_chamber(keys, c.chamber);
  visit_temperature(keys, c.temperature);
  visit_protocol(keys, c.protocol);
  if (c.protocol.is_constant_rate()) first.tolerances = with_effects_of_motion(first.tolerances);
  visit_effect_sizes(keys, first.tolerances, states_items, c.warnings);
  if (states_items) {
    keys.section("limits");
    visit_limits(keys, first.limits);
  }
  visit_notify(keys, c.notify);
  c.simulation.stands_in_second_face = c.protocol.faces == kFaces;
  visit_simulation(keys, c, states_items ? &first.simulation : nullptr);
  visit_link(keys, c.link);
  visit_emulator(keys, c.emulator, states_items ? &first : nullptr);

  keys.section("");
  if (is_list || keys.shows_every_form()) visit_list_of_items(keys, c);
  // Before the changes, which keep what they do not name.
  if (c.draw == kDrawStated && !keys.writes())
    draw_stated_truth(c, [&](const std::string& path) { return keys.gives(path); });
  keys.list("fault", c.faults, FaultConfig{}, visit_fault);
  keys.tables("change", c.changes.size(), [&](std::size_t i) {
    if (i >= c.changes.size()) c.changes.push_back({0.0, c.items.front().simulation});
    visit_change_of_bench(keys, c, i, is_list);
  });
}

}  // namespace abcal
